"""Work that is not pictures: distributed arrays over all ranks.

array.py   distributed arrays
blocks.py  their division into blocks, and the owners of these
"""
