"""What accuracy costs for one scene: every quality setting measured in time and in error, and the best of them marked.

- knobs.py      which settings there are, and which of their values are tried together
- measure.py    one setting on all ranks: its frames timed, its picture kept
- truth.py      the picture without error, and how well that is known
- similarity.py SSIM of two pictures
- rating.py     measurements beside the truth, the Pareto front, and what to say of them
- survey.py     all settings, one after another
- charts.py     error against time, samples, memory and bytes
- pictures.py   pictures and magnified errors for the page
- page.py       the page
"""
