"""Scene section `cluster`: distribution of the work over ranks."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from clusterviz.scene.checks import to_builtin
from clusterviz.scene.compatibility import check_brick_sizes, check_groups, check_mode
from clusterviz.scene.field_types import Section

Mode = Literal["auto", "sort-last", "sort-first", "hybrid"]
Tiling = Literal["auto", "interleaved", "pattern", "scheduled", "temporal", "estimated"]
Compositing = Literal[
    "auto",
    "serial",
    "pipeline",
    "tree",
    "direct-send",
    "binary-swap",
    "binary-swap-telescope",
    "binary-swap-remainder",
    "2-3-swap",
    "radix-k",
    "parallel-pipeline",
    "slic",
]
Codec = Literal[
    "auto",
    "raw",
    "active",
    "rectangle",
    "lz4",
    "shuffle+lz4",
    "delta+lz4",
    "active+lz4",
    "active+shuffle+lz4",
    "active+delta+lz4",
    "rectangle+lz4",
    "rectangle+shuffle+lz4",
    "rectangle+delta+lz4",
]
Transport = Literal["auto", "messages", "shared", "hierarchical"]
Distribution = Literal["auto", "coherent", "interleaved", "replicated", "dynamic"]


class Cluster(Section):
    """Distribution of the work over ranks; no setting here changes the picture."""

    mode: Mode = Field(
        default="auto",
        description="What is divided: the data (sort-last), the screen (sort-first), or the screen among groups of "
        "ranks and the data inside each (hybrid).",
    )
    groups: Annotated[int, Field(strict=True, ge=1), BeforeValidator(to_builtin)] | None = Field(
        default=None,
        description="Number of groups of ranks that share the screen: 1 is sort-last, one a rank sort-first.",
    )
    tiling: Tiling = Field(
        default="auto",
        description="Division of a shared screen: tiles in turn (interleaved), a pattern on the volume's front faces "
        "(pattern), tiles from a queue (scheduled), cuts by the last frame's cost (temporal), or by a coarse pre-pass "
        "(estimated).",
    )
    tile: Annotated[int, Field(strict=True, ge=8, le=65536), BeforeValidator(to_builtin)] = Field(
        default=32, description="Pixels along the side of a tile: interleaved, pattern, scheduled."
    )
    repetitions: Annotated[int, Field(strict=True, ge=1, le=1024), BeforeValidator(to_builtin)] = Field(
        default=3, description="Repetitions of the pattern along each side of a front face."
    )
    compositing: Compositing = Field(default="auto", description="Compositing algorithm for the partial images.")
    codec: Codec = Field(default="auto", description="Compression of pixels for sending.")
    transport: Transport = Field(
        default="auto", description="Transport of pixels: messages, memory shared by a node's ranks, or both."
    )
    distribution: Distribution = Field(
        default="auto",
        description="Assignment of bricks to ranks: coherent (a box a rank), interleaved (blocks in turn), replicated "
        "(each on several ranks; who draws it follows the cost), dynamic (boxes that follow the cost: bricks move from "
        "rank to rank between frames); auto: coherent.",
    )
    copies: Annotated[int, Field(strict=True, ge=1, le=65536), BeforeValidator(to_builtin)] = Field(
        default=2, description="Number of ranks that hold each brick in a replicated distribution; at most all."
    )
    memory_limit: Annotated[int, Field(strict=True, ge=1), BeforeValidator(to_builtin)] | None = Field(
        default=None,
        description="Bytes of bricks that a rank may hold: packed in OpenGL's memory, 4 bytes a voxel in the CPU ray "
        "caster, and what is read for them; bricks that do not fit are drawn in passes; default: no limit; three times "
        "an even share in a dynamic distribution.",
    )
    migration_bytes: Annotated[int, Field(strict=True, ge=1), BeforeValidator(to_builtin)] | None = Field(
        default=None,
        description="Bytes of bricks that all ranks together may start to send in a frame of a dynamic distribution; "
        "default: a twentieth of the bricks' bytes, a quarter if the load is far from even.",
    )
    migration_share: Annotated[float, Field(strict=True, gt=0, le=1), BeforeValidator(to_builtin)] = Field(
        default=0.05,
        description="Share of a frame's time that each rank of a dynamic distribution may spend on packing, sending, "
        "unpacking and storing bricks; 1: no limit.",
    )
    brick: Annotated[int, Field(strict=True, ge=2, le=1024), BeforeValidator(to_builtin)] = Field(
        default=64, description="Voxels along the side of a brick."
    )
    largest_brick: Annotated[int, Field(strict=True, ge=8, le=1024), BeforeValidator(to_builtin)] | None = Field(
        default=None,
        description="Voxels along the longest side of a brick: bricks have the size `brick` near the expected borders "
        "between ranks, and are larger elsewhere; a multiple of `brick`, which is a multiple of 8. For one volume and "
        "the CPU ray caster; null: all bricks have the size `brick`.",
    )

    @model_validator(mode="after")
    def _groups_fit(self) -> Cluster:
        check_groups(self.mode, self.groups)
        check_brick_sizes(self.brick, self.largest_brick)
        check_mode(self.mode, self.tiling, self.distribution, self.compositing, self.transport)
        return self
