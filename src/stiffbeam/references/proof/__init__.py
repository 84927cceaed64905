"""Proofs about exact motions by ball arithmetic. In the order of reading:

orbit_proof    a periodic orbit: Krawczyk's test on its event times, its gaps' signs, its multipliers
ball_flow      the system in balls: flows, forms, signs over a segment
"""
