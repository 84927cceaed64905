"""Case files, trajectories on disk and frozen references."""
