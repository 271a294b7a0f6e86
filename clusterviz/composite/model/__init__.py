"""Time model of compositing, and the automatic choice of algorithm and transport.

- network.py        constants of the model, and the files that hold them (networks/)
- fitting.py        fit of the constants to measured times
- communication.py  communication cost of each algorithm in closed form
- prediction.py     predicted time
- choice.py         automatic choice
"""
