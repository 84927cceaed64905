"""The exact solution in many digits. In reading order:

multiprecision          number of digits, two solutions that have to agree, motion from event to event
rational                the system from its exact parameters
linear_flow             system and loads as z' = G z: blocks from float64, refined
"""
