from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from clusterviz.errors import InputError
from clusterviz.gl.reals import ENVIRONMENT, EXTENSION, chosen_reals


def context(renderer: str, *extensions: str) -> Any:
    return SimpleNamespace(info={"GL_RENDERER": renderer}, extensions=set(extensions))


@pytest.mark.parametrize(
    ("renderer", "form"),
    [
        ("llvmpipe (LLVM 15.0.7, 256 bits)", "double"),
        ("NVIDIA H100 80GB HBM3/PCIe/SSE2", "double"),
        ("NVIDIA A100-SXM4-40GB/PCIe/SSE2", "double"),
        ("AMD Instinct MI210 (radeonsi, gfx90a)", "double"),
        ("NVIDIA GeForce RTX 4090/PCIe/SSE2", "integer"),
        ("NVIDIA A10/PCIe/SSE2", "integer"),
        ("AMD Radeon RX 7900 XTX (radeonsi, navi31)", "integer"),
        ("Mesa Intel(R) Arc(tm) A770 Graphics (DG2)", "integer"),
    ],
)
def test_form_is_chosen_by_the_device(renderer: str, form: str) -> None:
    assert chosen_reals(context(renderer, EXTENSION), {}) == form
    assert chosen_reals(context(renderer), {}) == "integer", "double precision is not there"


def test_form_may_be_forced() -> None:
    assert chosen_reals(context("llvmpipe"), {ENVIRONMENT: "double"}) == "double"
    with pytest.raises(InputError, match=r"CLUSTERVIZ_REALS: no such form.*found float.*allowed double, integer"):
        chosen_reals(context("llvmpipe"), {ENVIRONMENT: "float"})
