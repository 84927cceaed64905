"""Dumont (2002) remade: every table and figure, its claims and misprints judged, on one page.

    reading -> table (runs beside their references) -> numbers, figures -> claims, misprints -> page

One table is made by one process; its numbers stand in a journal, so that a second run takes them from there.
"""
