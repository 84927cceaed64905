"""What does one step of each scheme make of a free oscillation: how late, how much weaker, how stable?

    python studies/amplification.py

On every registered scheme and its family of parameters. Records and picture go to stiffbeam-output/table10.
"""

from stiffbeam.studies import study

OUT = "stiffbeam-output/table10"

if __name__ == "__main__":
    records = study("amplification", "table10", folder=f"{OUT}/journal", jobs=2)
    records.save(OUT)
    print(records.answer)
