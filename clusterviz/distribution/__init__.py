"""Distributions, which assign the bricks of a frame to ranks.

Static, dynamic and sort-first distributions have one contract. The package also has what they need: expected and
measured cost of bricks, the load balancer, and the memory budget.
"""
