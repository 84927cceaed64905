"""The compiled loops of the march, and the same in NumPy and JAX."""
