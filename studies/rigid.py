"""How stiff must a stop be before it acts like a rigid one, and how fast is that limit approached?

    python studies/rigid.py

On Table 10; `stiffbeam rigid CASE` asks it of any case. Records and picture go to stiffbeam-output/table10.
"""

from stiffbeam.studies import study

OUT = "stiffbeam-output/table10"

if __name__ == "__main__":
    records = study("rigid", "table10", folder=f"{OUT}/journal", jobs=2)
    records.save(OUT)
    print(records.answer)
