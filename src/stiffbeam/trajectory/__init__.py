"""Runs, whoever made them: states, impacts, ledger."""
