"""Where does the energy go: how much does each scheme lose, in contact and between impacts?

    python studies/energy.py

On Table 10; `stiffbeam energy CASE` asks it of any case. Records and picture go to stiffbeam-output/table10.
"""

from stiffbeam.studies import study

OUT = "stiffbeam-output/table10"

if __name__ == "__main__":
    records = study("energy", "table10", folder=f"{OUT}/journal", jobs=2)
    records.save(OUT)
    print(records.answer)
