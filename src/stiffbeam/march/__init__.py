"""Marching a scheme over a system, in the order of reading:

    integrate, ensemble    what is called: one run, many members
    direct_march           any scheme on any system, with factorised matrices
    block_march            systems whose modes decouple, in blocks of K steps
    probe, build           a scheme's own step, taken with unit inputs, arranged for such blocks
    propagator, layout     what comes out: a map and its arrays
    kernel                 the loops over them, compiled; kernel_numpy and kernel_jax do the same
    replay, single_steps   what blocks pass over, when it is asked for: states and energies

A run is a function of its arguments: made again, it has the same bits.
"""
