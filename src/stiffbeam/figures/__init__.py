"""Pictures: one look for each method, the chart that a study declares, and pictures of results."""
