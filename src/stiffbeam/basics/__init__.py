"""The ground of every other room: arrays, units, checks of input, files and compilation."""
