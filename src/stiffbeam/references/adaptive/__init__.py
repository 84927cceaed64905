"""The adaptive solvers, whose error control chooses their steps. In reading order:

sundials, diffrax, scipy         one library each: ``solve(request)``
adaptive                         common parts: tolerances, the Reference from a solution
restarts                         integration from event to event, in intervals in which the functions of time are smooth
"""
