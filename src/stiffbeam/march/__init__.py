"""Marching a scheme over a system, in the order of reading:

integrate, ensemble   what is called: one run, many members (``members``)
direct_march          any scheme on any system, with factorised matrices, in ``pieces``
modal_march           systems whose modes decouple, in blocks of K steps
probe, propagator     a scheme's own step, taken with unit inputs, as the arrays of such a block
layout                these arrays
kernel                the loops over them, compiled; ``kernel_numpy`` and ``kernel_jax`` do the same
"""
