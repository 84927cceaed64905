"""Case files, saved trajectories, frozen references, and the cache of references."""
