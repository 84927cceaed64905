"""The exact solution in many digits. In reading order:

multiprecision          what is called: how many digits, two runs that have to agree, motion between compliant stops
rational                the system from its exact parameters
linear_flow             all that drives it as z' = G z: blocks that float64 knows, power series, certain zeros of them
rigid, impacting        rigid stops, from impact to impact by series alone: no code is shared with float64's
"""
