"""The section of a scene that says how the ranks share the work."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from clusterviz.scene.checks import plain
from clusterviz.scene.cluster_checks import check_groups, check_sharing
from clusterviz.scene.kinds import Section


class Cluster(Section):
    """How the ranks share the work; no setting here changes the picture."""

    mode: Literal["auto", "sort-last", "sort-first", "hybrid"] = Field(
        default="auto",
        description="What is divided: the data (sort-last), the screen (sort-first), or the screen among groups of "
        "ranks and the data inside each (hybrid).",
    )
    groups: Annotated[int, Field(strict=True, ge=1), BeforeValidator(plain)] | None = Field(
        default=None, description="How many groups of ranks share the screen: 1 is sort-last, one a rank sort-first."
    )
    tiling: Literal["auto", "interleaved", "pattern", "scheduled", "temporal", "estimated"] = Field(
        default="auto",
        description="How the screen is shared, where it is: tiles in turn (interleaved), a pattern on the volume's "
        "front faces (pattern), tiles from a queue (scheduled), cuts by the last frame's cost (temporal), or by a "
        "coarse pre-pass (estimated).",
    )
    tile: Annotated[int, Field(strict=True, ge=8, le=65536), BeforeValidator(plain)] = Field(
        default=32, description="Pixels along the side of a tile: interleaved, pattern, scheduled."
    )
    repetitions: Annotated[int, Field(strict=True, ge=1, le=1024), BeforeValidator(plain)] = Field(
        default=3, description="Of the pattern along each side of a front face."
    )
    compositing: Literal[
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
    ] = Field(default="auto", description="The algorithm that joins the partial images.")
    codec: Literal[
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
    ] = Field(default="auto", description="How pixels are packed for sending.")
    transport: Literal["auto", "messages", "shared", "hierarchical"] = Field(
        default="auto", description="How pixels travel: messages, memory shared by a node's ranks, or both."
    )
    distribution: Literal["auto", "coherent", "interleaved", "replicated", "dynamic"] = Field(
        default="auto",
        description="How bricks are dealt to ranks: coherent (a box a rank), interleaved (blocks in turn), replicated "
        "(each on several ranks; who draws it follows the cost), dynamic (boxes that follow the cost: bricks move from "
        "rank to rank between frames); auto: coherent.",
    )
    copies: Annotated[int, Field(strict=True, ge=1, le=65536), BeforeValidator(plain)] = Field(
        default=2, description="Ranks that hold each brick, where the distribution is replicated; at most all."
    )
    memory_limit: Annotated[int, Field(strict=True, ge=1), BeforeValidator(plain)] | None = Field(
        default=None,
        description="Bytes of bricks that a rank may hold for drawing, as they lie there: packed in OpenGL's memory, 4 "
        "bytes a voxel where the processor draws without it; default: any; thrice an even share where the distribution "
        "is dynamic.",
    )
    migration_bytes: Annotated[int, Field(strict=True, ge=1), BeforeValidator(plain)] | None = Field(
        default=None,
        description="Bytes of bricks that all ranks together may start to send in a frame, where the distribution is "
        "dynamic; default: a twentieth of the bricks' bytes, a quarter where ranks are far from even.",
    )
    migration_share: Annotated[float, Field(strict=True, gt=0, le=1), BeforeValidator(plain)] = Field(
        default=0.05,
        description="Share of a frame's time that each rank may spend on packing, sending, opening and storing bricks, "
        "where the distribution is dynamic; 1: as much as there is to do.",
    )
    brick: Annotated[int, Field(strict=True, ge=2, le=1024), BeforeValidator(plain)] = Field(
        default=64, description="Voxels along the side of a brick."
    )

    @model_validator(mode="after")
    def _groups_fit(self) -> Cluster:
        check_groups(self.mode, self.groups)
        check_sharing(self.mode, self.tiling, self.distribution, self.compositing, self.transport)
        return self
