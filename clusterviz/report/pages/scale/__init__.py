"""How a scene scales: more ranks for the same work, more work with more ranks, and what is to be expected beyond.

- measure.py   one rank count: its frames timed, what it sent counted, its picture kept
- rounds.py    messages and pixels of each round beside what the schedule says
- points.py    one rank count as numbers for people: efficiency, imbalance, memory
- survey.py    all rank counts of a scene, one after another
- forecast.py  the time model up to 65,536 ranks, with what was measured put in
- verdict.py   what limits the scene, in sentences
- charts.py    the plots
- page.py      the report as files
"""
