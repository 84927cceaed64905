"""The compiled loops of the march."""
