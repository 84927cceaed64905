"""What is measured of a run, each quantity defined once."""
