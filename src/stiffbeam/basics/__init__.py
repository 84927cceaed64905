"""What every other room builds on: arrays, units, checks of input, files and compilation."""
