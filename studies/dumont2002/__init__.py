"""Dumont (2002) reproduced: every table and figure, its claims and misprints judged, on one page.

    reading -> table (runs beside their references) -> numbers, figures -> claims, misprints -> page

One process computes one table and writes its numbers to a journal, from which a second run reads them.
"""
