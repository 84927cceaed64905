"""The adaptive solvers, whose error control chooses their steps. In reading order:

sundials, diffrax, scipy                 one library each: ``solve(request)``
adaptive                                 what all share: tolerances before, the Reference after
restarts                                 from event to event, by the roots of every gap; the size of every unknown
pieces                                   where the functions of time are smooth, and the steps this allows
"""
