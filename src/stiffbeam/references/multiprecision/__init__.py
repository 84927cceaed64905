"""The exact solution in many digits. In the order of reading:

multiprecision                           what is called: how many digits, and two runs that have to agree
undamped, exponential                    the regimes of exact/undamped and exact/exponential in those digits
modes                                    eigenvectors and switching times, refined from those of float64
rational                                 the system from its exact parameters
rigid, impacting, complementarity        rigid stops, from impact to impact; it shares no code with float64's
linear_flow, first_zero                  power series of a linear system, and certain zeros of them
"""
