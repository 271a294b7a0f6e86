"""Stores: volumes with levels and compressed bricks, as OME-Zarr.

`writer.py` makes a store of any source, `shards.py` reads and writes its files, `levels.py` has the low-pass and its
errors, `wavelet.py` the codec of bricks, and `zarr_codec.py` makes that known to zarr-python. Stores are opened by
`clusterviz.data.formats.ome_zarr`.
"""
