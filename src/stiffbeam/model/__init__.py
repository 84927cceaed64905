"""The problem, its discretisation and the law of contact."""
