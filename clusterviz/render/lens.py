
import numpy as np
MODE="none"
SAVED=[]
def depth_of_field(merged, lens):
    m = lens.count
    h = merged.shape[0]//m
    subs = np.moveaxis(merged.reshape(h, m, merged.shape[1], 4), 1, 0)
    SAVED.append((subs.copy(), lens))
    out = np.zeros_like(subs[0])
    for s in subs[::-1]:
        out = s + (1 - s[...,3:])*out
    g = lens.margin
    return out[g:h-g, g:merged.shape[1]-g].copy() if g else out
