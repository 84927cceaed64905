"""The exact solution in many digits. In reading order:

multiprecision          number of digits, two solutions that have to agree, motion between compliant stops
rational                the system from its exact parameters
linear_flow             system and loads as z' = G z: blocks from float64, power series, their proved first zeros
rigid, impacting        rigid stops, from impact to impact by series; no code is shared with the float64 solution
"""
