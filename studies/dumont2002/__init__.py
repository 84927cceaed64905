"""Dumont (2002) reproduced: tables, figures, numeric claims, costs and misprints on one page.

table (runs beside their references) -> numbers, figures -> claims, costs, misprints -> page
"""
