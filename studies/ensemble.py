"""Past the horizon, do the schemes at least have the right distribution of impacts, forces and spectra?

    python studies/ensemble.py

On Table 10; `stiffbeam ensemble CASE` asks it of any case. Records and picture go to stiffbeam-output/table10.
"""

from stiffbeam.studies import study

OUT = "stiffbeam-output/table10"

if __name__ == "__main__":
    records = study("ensemble", "table10", folder=f"{OUT}/journal", jobs=2)
    records.save(OUT)
    print(records.answer)
