"""The time model: what a composition should take, and what to choose by it.

- network.py     the constants, and the files that hold them (networks/)
- fitting.py     from measured times to constants
- moves.py       what each algorithm moves, in short
- prediction.py  how long it should take
- choice.py      what "auto" means
"""
