"""Case files, trajectories on disk, and stored references."""
