"""Looks: what the samples of rays come to.

- samples.py          the samples of runs
- composite.py        emission and absorption
- preintegrated.py    the same for slabs that are classified between their ends
- mixture.py          several volumes, mixed slab by slab
- ramped.py           one of them whose slabs are classified between their ends
- over.py             how runs of all these are put behind others
- projections.py      maximum, minimum, average and sum
- local_maximum.py    the first stretch above a threshold
- surfaces.py         isosurfaces, alone or in a volume
- course.py           the field along slabs, as far as they need it
- root.py             where the field is their value
- optics.py           what samples are, all in all
- relief.py           all that depends on the gradient
- light.py            lights on a volume
"""
