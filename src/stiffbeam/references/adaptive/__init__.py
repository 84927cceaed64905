"""The adaptive solvers, whose error control chooses their steps. In the order of reading:

cvode, ida, kvaerno, scipy               one library each: ``solve(request)``
sundials                                 what CVODE and IDA share
adaptive                                 what all share: tolerances before, the Reference after
restarts                                 from switch to switch, by the roots of every gap
pieces                                   where the functions of time are smooth, and the steps this allows
rhs, scales                              the right-hand side and its Jacobian; the size of every unknown
contact_records                          from switches to impacts
"""
