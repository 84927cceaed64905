"""Studies: questions asked of cases, records out."""
