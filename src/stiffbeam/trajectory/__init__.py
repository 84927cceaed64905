"""Results of schemes, solvers and other programs: states, contacts, impacts, energy balance, and their files."""
