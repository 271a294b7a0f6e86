"""What clients are told of the content: histograms, ranges, boxes, colour maps, and the keys of scenes."""

from __future__ import annotations

import functools
import json
import re
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from clusterviz.content.complete import complete_scene
from clusterviz.content.facts import Facts, bounds
from clusterviz.content.table import KINDS, drawn_entries, infos_of, own_entries
from clusterviz.content.volume.kind import MOST_BINS, VOLUME
from clusterviz.content.volume.presets import PRESETS, apply_preset
from clusterviz.errors import InputError, public_address
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.colormaps import colour_points, map_names
from clusterviz.scene.transfer import opacity_points
from clusterviz.scene.values import Scene

PREVIEW_COLOURS = 16
COMMON_MAPS = (
    *("bone", "gray", "viridis", "plasma", "inferno", "magma", "cividis", "turbo", "hot", "afmhot", "copper", "jet"),
    *("rainbow", "coolwarm", "bwr", "RdBu", "RdYlBu", "Spectral", "Blues", "Greens", "Reds", "YlOrRd", "pink"),
    *("batlow", "roma", "vik", "berlin", "thermal", "haline", "ice", "balance", "blackbody", "glasbey", "tab10"),
)


@dataclass(frozen=True)
class Content:
    """What is known of the data of a scene. `infos`: facts on each entry of the scene, as opened."""

    infos: tuple[Facts, ...]

    def complete(self, scene: Scene) -> Scene:
        """Return a scene with all keys."""
        return complete_scene(scene, self.infos)

    def hello(self) -> dict[str, Any]:
        """Return what a client is told once."""
        return {
            "version": version("clusterviz"),
            "colour_maps": known_colour_maps(),
            "presets": [{"name": name, "description": each.description} for name, each in PRESETS.items()],
            "keys": known_keys(),
            "blend_modes": {
                name: {"threshold": mode.threshold, "surfaces": mode.surfaces} for name, mode in BLEND_MODES.items()
            },
        }

    def preset(self, volume: int, name: str) -> dict[str, Any]:
        """Return the changes of a preset, by full keys. Raises InputError: there is no such volume or preset."""
        volumes = infos_of(VOLUME, self.infos)
        if volume >= len(volumes):
            raise InputError("no such volume", where="preset", found=volume, allowed=f"fewer than {len(volumes)}")
        if name not in PRESETS:
            raise InputError("unknown preset", where="preset", found=name, allowed=", ".join(PRESETS))
        keys = json.loads(json.dumps(apply_preset(name, volumes[volume])))
        return {f"volumes.{volume}.{key}": value for key, value in keys.items()}

    def state(self, completed: Scene) -> dict[str, Any]:
        """Return what a client is told of the data and of the transfer functions."""
        boxes = [entry.kind.corners(entry.section, entry.info) for entry in drawn_entries(completed, self.infos)]
        corners = np.concatenate([*boxes, np.empty((0, 3))])
        found: dict[str, Any] = {kind.name: [] for kind in KINDS}
        for entry in own_entries(completed, self.infos):
            key = entry.key.replace("[", ".").rstrip("]")
            panel = entry.kind.panel(entry.section, entry.info)
            found[entry.kind.name].append({**panel, **_entry(key, entry.section)})
        around = np.array([corners.min(axis=0), corners.max(axis=0)]) if len(corners) else corners
        return {**found, "bounds": bounds(around)}


def _entry(key: str, section: Any) -> dict[str, Any]:
    """Return the key, the name and the completed transfer function of an entry of a scene."""
    clim, cmap, opacity = section.clim, section.cmap, getattr(section, "opacity", None)
    colours = opacities = None
    if clim is not None and cmap is not None:
        values, rgb = colour_points(cmap, clim)
        colours = np.column_stack([values, rgb])[:MOST_BINS].tolist()
    if clim is not None and opacity is not None and not isinstance(opacity, float):
        opacities = np.column_stack(opacity_points(opacity, clim))[:MOST_BINS].tolist()
    return {
        "key": key,
        "name": Path(public_address(section.path)).name,
        "colour_points": colours,
        "opacity_points": opacities,
    }


def known_colour_maps() -> list[dict[str, Any]]:
    """Return colour maps with previews: at first common ones, while a thread prepares all, which takes a second."""
    with _PREPARING:
        if not _ALL_MAPS and not _THREADS:
            _THREADS.append(threading.Thread(target=lambda: _ALL_MAPS.extend(colour_maps(_names())), daemon=True))
            _THREADS[0].start()
    return list(_ALL_MAPS) or colour_maps(COMMON_MAPS)


_ALL_MAPS: list[dict[str, Any]] = []
_THREADS: list[threading.Thread] = []
_PREPARING = threading.Lock()


def _names() -> tuple[str, ...]:
    """Return the names of all colour maps but those of fewer colours (Blues_3)."""
    return tuple(name for name in map_names() if not re.search(r"_\d+$", name))


@functools.cache
def colour_maps(names: tuple[str, ...]) -> list[dict[str, Any]]:
    """Return colour maps with a preview of `PREVIEW_COLOURS` colours."""
    places, found = np.linspace(0, 1, PREVIEW_COLOURS), []
    for name in names:
        values, rgb = colour_points(name, (0.0, 1.0))
        colours = np.stack([np.interp(places, values, channel) for channel in np.asarray(rgb).T], axis=1)
        found.append({"name": name, "colours": colours.round(3).tolist()})
    return found


@functools.cache
def known_keys() -> dict[str, Any]:
    """Return description, choices and limits of the keys of scenes, by their full paths; indices are 0."""
    schema = Scene.model_json_schema()
    found: dict[str, Any] = {}
    _add_keys(found, schema, schema["$defs"], "")
    return found


def _add_keys(found: dict[str, Any], section: Mapping[str, Any], known: Mapping[str, Any], path: str) -> None:
    for name, entry in section.get("properties", {}).items():
        full = f"{path}.{name}" if path else name
        found[full] = _limits(entry)
        options = [entry, *entry.get("anyOf", [])]
        options += [option["items"] for option in options if "items" in option]
        for option in options:
            inner = known.get(option.get("$ref", "").rpartition("/")[2])
            if inner and "properties" in inner:
                is_list = option is not entry and option not in entry.get("anyOf", [])
                _add_keys(found, inner, known, f"{full}.0" if is_list else full)


def _limits(entry: Mapping[str, Any]) -> dict[str, Any]:
    words = {"minimum": "minimum", "maximum": "maximum", "exclusiveMinimum": "above", "exclusiveMaximum": "below"}
    options: Sequence[Mapping[str, Any]] = [entry, *entry.get("anyOf", [])]
    about: dict[str, Any] = {"description": entry.get("description", "")}
    if "default" in entry:
        about["default"] = entry["default"]
    for option in options:
        about |= {words[key]: option[key] for key in words if key in option}
        if choices := option.get("enum") or ([option["const"]] if "const" in option else []):
            about["choices"] = [*about.get("choices", []), *choices]
    return about
