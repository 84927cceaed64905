"""The engine of studies: points, processes, journal."""
