"""The base layer, which every other folder uses: arrays, units, checks of input, memory and time limits, files."""
