"""What a run is, whoever made it: states, impacts, ledger."""
