"""The exact solution in many digits. In reading order:

multiprecision          number of digits, two solutions that have to agree, motion from event to event
linear_flow             the system from its exact parameters, as z' = G z: blocks from float64, refined
"""
