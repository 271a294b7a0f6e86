"""Random draws take the same samples in one piece and in many, by the processor and by OpenGL."""

from __future__ import annotations

import pytest
from ownership import counted, random_draws

from clusterviz.gl.context import open_context


def test_every_slab_is_drawn_once_whoever_draws_it() -> None:
    for draw, counts in counted(random_draws(12, seed=7), None):
        assert len(set(counts.values())) == 1, f"{draw}: {counts}"


@pytest.mark.gl
def test_opengl_takes_the_samples_of_the_processor() -> None:
    with open_context() as context:
        for draw, counts in counted(random_draws(6, seed=8), context):
            assert len(counts) == 4
            assert len(set(counts.values())) == 1, f"{draw}: {counts}"
