"""Any schedule on up to 65,536 ranks, without MPI: counted, predicted, drawn.

- simulate.py                               one composition
- closed_forms.py, closed_forms_sparse.py   counts of algorithms with n² transfers
- cubes.py, flow.py                         sparse images: where bricks project to, and what then moves
- drawing.py                                who sends to whom, as a picture
"""
