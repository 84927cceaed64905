"""The base layer, which every other package uses: arrays, text and units, checks of input, files, long calls."""
