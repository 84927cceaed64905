"""The exact solution in many digits. In reading order:

multiprecision          what is called: how many digits, and two runs that have to agree
rational                the system from its exact parameters
linear_flow             all that drives it as z' = G z: blocks that float64 knows, power series, certain zeros of them
compliant               motion between compliant stops, and contacts that float64 does not see
rigid, impacting        rigid stops, from impact to impact by series alone: no code is shared with float64's
"""
