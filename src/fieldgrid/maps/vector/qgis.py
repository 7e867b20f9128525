"""How QGIS shows a map: a style for each of its layers, in QGIS's own XML (QML).

Obstacles are red on pale ground, drives have the colours of their sessions, footprints are hollow
and seen from near only. These styles are in the map file, for a layer that is opened by itself, and
in a project.
"""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import chain, product, zip_longest
from pathlib import Path
from xml.etree import ElementTree as ET
from xml.etree.ElementTree import Element

from fieldgrid.core import palette

VERSION = "3.22.0"
"""Of QGIS, whose styles these are; later ones read them, too."""

_DOCTYPE = "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"

_RASTER = "Symbology|Rendering"
"""The parts that the document of a raster has."""

_ALPHA_BAND = 4
"""GDAL shows the grey and alpha of a GeoPackage's tiles as red, green, blue and alpha."""


_VALUES = (0, 50, 100, 101, 255)
"""The densities at which the colours of the palette begin: its edge lies between two of them."""

_LABELS = {0: "0: free", 101: "101: obstacle"}


_LONGEST_LABEL = 80

_NAME = "\N{REPLACEMENT CHARACTER}"
"""Stands for the names of sessions in a document without them."""


_LOOKS = {
    "trajectory": ("marker", None),
    "frame_position": ("marker", 1500),
    "footprint": ("fill", 400),
}
"""Of each layer of features its kind of symbol, and the smallest scale (1 in n) it is seen at."""


LAYERS = ("density", *_LOOKS)
"""The layers that have a style, from the lowest to the uppermost as they are to be drawn."""


MARKS = {"mark_area": "Polygon", "mark_point": "Point"}
"""What people said of places, in a project: marks by their kind of geometry. The map file has all
of them in one layer, `mark`."""

_MARK_RULES = {
    "keepout": ("keep out", "b_diagonal"),
    "obstacle": ("this is an obstacle", "diagonal_x"),
    "free": ("this is free", "no"),
    "place": ("place", "no"),
}
"""Each kind of mark in words, and how its areas are hatched."""


def style(layer: str, sessions: Sequence[tuple[str, str]]) -> str:
    """The QML document of a layer; `sessions` are their names and colours (`#rrggbb`)."""
    colours, texts = _texts(tuple(sessions)) if layer in _LOOKS else ((), ())
    return "".join(chain.from_iterable(zip_longest(_pieces(layer, colours), texts, fillvalue="")))


@lru_cache(maxsize=1)
def _texts(sessions: tuple[tuple[str, str], ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The colours of sessions, and what stands for the names of each in a document: the same in
    all layers."""
    named = _by_colour(sessions)
    texts = (text for names in named.values() for text in (_label(names), _listed(names)))
    return tuple(named), tuple(
        html.escape(text, quote=False).replace('"', "&quot;") for text in texts
    )


@lru_cache(maxsize=64)
def _pieces(layer: str, colours: tuple[str, ...]) -> tuple[str, ...]:
    """What stands around the names of sessions in a document, which each commit writes."""
    root = Element("qgis", version=VERSION, styleCategories="Symbology|Rendering|Temporal")
    fill_style(root, layer, [(_NAME, colour) for colour in colours])
    ET.indent(root)
    document = _DOCTYPE + ET.tostring(root, encoding="unicode")
    return tuple(document.replace(_quoted(_NAME), _NAME).split(_NAME))


def _by_colour(sessions: Sequence[tuple[str, str]]) -> dict[str, list[str]]:
    """The names of sessions by their colours."""
    named: dict[str, list[str]] = {}
    for name, colour in sessions:
        if name.isprintable():  # another one XML cannot have: it is drawn as one of the others
            named.setdefault(colour, []).append(name)
    return named


def _label(names: Sequence[str]) -> str:
    label = ", ".join(names)
    return label if len(label) <= _LONGEST_LABEL else f"{label[:_LONGEST_LABEL]}..."


def _listed(names: Sequence[str]) -> str:
    return ", ".join(map(_quoted, names))


def fill_style(root: Element, layer: str, sessions: Sequence[tuple[str, str]]) -> None:
    """Put the parts of a layer's style into an element: a document's root, or a project's layer."""
    if layer == "density":
        stops = [
            (value, stop.colour, _LABELS.get(value, ""))
            for stop, value in zip(palette.DENSITY, _VALUES, strict=True)
        ]
        _fill_raster(root, stops, _ALPHA_BAND)
        return
    if layer == "mark" or layer in MARKS:
        _fill_marks(root, layer)
        return
    kind, from_scale = _LOOKS[layer]
    if from_scale is not None:
        root.set("hasScaleBasedVisibilityFlag", "1")
        root.set("minScale", str(from_scale))
        root.set("maxScale", "0")
    temporal = ET.SubElement(root, "temporal", mode="1", enabled="1", startField="time")
    temporal.set("durationUnit", "min")
    temporal.set("accumulate", "1")
    renderer = ET.SubElement(root, "renderer-v2", type="RuleRenderer", symbollevels="0")
    rules = ET.SubElement(renderer, "rules", key="{root}")
    symbols = ET.SubElement(renderer, "symbols")
    for colour, names in _by_colour(sessions).items():
        key = str(len(symbols))
        ET.SubElement(
            rules, "rule", key=f"{{{key}}}", symbol=key, label=_label(names),
            filter=f"\"session\" IN ({_listed(names)}) AND \"status\" <> 'rejected'",
        )  # fmt: skip
        symbols.append(_symbol(key, kind, layer, colour))
    for label, condition, colour in (
        ("rejected", "\"status\" = 'rejected'", palette.REJECTED),
        ("other sessions", "ELSE", palette.REJECTED),
    ):
        key = str(len(symbols))
        ET.SubElement(rules, "rule", key=f"{{{key}}}", symbol=key, label=label, filter=condition)
        symbols.append(_symbol(key, kind, layer, colour, rejected=label == "rejected"))


def raster_style(ramp: palette.Ramp, low: float, high: float, alpha_band: int) -> str:
    """The QML document of a raster whose band 1 is drawn by a ramp from `low` to `high`; what its
    `alpha_band` leaves out is not drawn (-1: it has none)."""
    root = Element("qgis", version=VERSION, styleCategories=_RASTER)
    stops = [(low + stop.share * (high - low), stop.colour, "") for stop in ramp]
    _fill_raster(root, stops, alpha_band)
    ET.indent(root)
    return _DOCTYPE + ET.tostring(root, encoding="unicode")


def is_raster_style(path: Path) -> bool:
    """Whether a document is one of `raster_style`, and not one that QGIS has saved."""
    begins = f'{_DOCTYPE}<qgis version="{VERSION}" styleCategories="{_RASTER}">\n'.encode()
    with path.open("rb") as file:
        return file.read(len(begins)) == begins


def _fill_raster(root: Element, stops: Sequence[tuple[float, str, str]], alpha_band: int) -> None:
    """Colours at values, each with its label, and mixed between them."""
    low, high = str(stops[0][0]), str(stops[-1][0])
    pipe = ET.SubElement(root, "pipe")
    renderer = ET.SubElement(
        pipe, "rasterrenderer", type="singlebandpseudocolor", band="1",
        alphaBand=str(alpha_band), opacity="1", classificationMin=low, classificationMax=high,
    )  # fmt: skip
    shader = ET.SubElement(
        ET.SubElement(renderer, "rastershader"), "colorrampshader", colorRampType="INTERPOLATED",
        classificationMode="1", minimumValue=low, maximumValue=high, clip="0",
    )  # fmt: skip
    for value, colour, label in stops:
        ET.SubElement(
            shader, "item", value=str(value), color=colour, alpha="255", label=label or str(value)
        )
    ET.SubElement(pipe, "rasterresampler", maxOversampling="2")
    ET.SubElement(root, "blendMode").text = "0"


def _fill_marks(root: Element, layer: str) -> None:
    root.set("labelsEnabled", "1")
    renderer = ET.SubElement(root, "renderer-v2", type="RuleRenderer", symbollevels="0")
    rules = ET.SubElement(renderer, "rules", key="{root}")
    symbols = ET.SubElement(renderer, "symbols")
    shapes = MARKS.values() if layer == "mark" else (MARKS[layer],)
    for key, (shape, kind) in enumerate(product(shapes, _MARK_RULES)):
        label, hatch = _MARK_RULES[kind]
        ET.SubElement(
            rules, "rule", key=f"{{{key}}}", symbol=str(key), label=label,
            filter=f"\"kind\" = '{kind}' AND geometry_type($geometry) = '{shape}'",
        )  # fmt: skip
        colour = ",".join(map(str, palette.rgb(palette.MARKS[kind])))
        is_area = shape == "Polygon"
        form = {"style": hatch} if is_area else {"name": "circle", "size": "3", "size_unit": "MM"}
        symbol = ET.SubElement(
            symbols, "symbol", name=str(key), type="fill" if is_area else "marker", alpha="1"
        )
        part = ET.SubElement(
            symbol, "layer", {"class": "SimpleFill" if is_area else "SimpleMarker"}, enabled="1"
        )
        outline = colour if is_area else "255,255,255"
        edge = {"outline_color": f"{outline},255", "outline_width": "0.5"}
        _add_values(part, {**form, **edge, "color": f"{colour},255"})
    labels = ET.SubElement(root, "labeling", type="simple")
    settings = ET.SubElement(labels, "settings")
    text = ET.SubElement(
        settings, "text-style", fieldName="name", fontSize="9", textColor="34,34,34,255"
    )
    white = {"bufferDraw": "1", "bufferSize": "1", "bufferColor": "255,255,255,255"}
    ET.SubElement(text, "text-buffer", white)


def _symbol(name: str, kind: str, layer: str, colour: str, *, rejected: bool = False) -> Element:
    symbol = Element("symbol", name=name, type=kind, alpha="1", clip_to_extent="1")
    fill = ",".join(map(str, palette.rgb(colour)))
    if kind == "fill":
        values = {
            "style": "no",
            "color": f"{fill},0",
            "outline_color": f"{fill},160",
            "outline_style": "dash" if rejected else "solid",
            "outline_width": "0.2",
            "outline_width_unit": "MM",
        }
        part = ET.SubElement(symbol, "layer", {"class": "SimpleFill"}, enabled="1", locked="0")
    else:
        near = layer == "frame_position"
        values = {
            "name": "cross2" if rejected else "circle",
            "color": f"{fill},255",
            "outline_color": f"{fill},255" if rejected else "255,255,255,255",
            "outline_style": "solid" if rejected or near else "no",
            "outline_width": "0.3" if rejected else "0.2",
            "outline_width_unit": "MM",
            "size": "2.2" if near else "1.2",
            "size_unit": "MM",
        }
        part = ET.SubElement(symbol, "layer", {"class": "SimpleMarker"}, enabled="1", locked="0")
    part.set("pass", "0")
    _add_values(part, values)
    return symbol


def _add_values(part: Element, values: Mapping[str, str]) -> None:
    """Values in the form of QGIS 3.22 and later, and in that of those before."""
    options = ET.SubElement(part, "Option", type="Map")
    for key, value in values.items():
        ET.SubElement(options, "Option", name=key, value=value, type="QString")
    for key, value in values.items():
        ET.SubElement(part, "prop", k=key, v=value)


def _quoted(text: str) -> str:
    """Text as a value of QGIS's expressions."""
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"
