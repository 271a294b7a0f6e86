"""Kinds of content: what a scene shows, one folder each behind the contract in `contract`, listed in `table`."""
