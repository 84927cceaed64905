"""What runs a study: points, processes, journal."""
