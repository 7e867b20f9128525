"""How the drives of a map lie against each other, from the evidence in it and nothing else.

1. Drives are cut into submaps of some metres, within which poses are trusted.
2. As wholes, every two drives that saw the same ground are compared over all shifts in reach:
   where rows repeat there are several answers, and then these two are not compared further.
3. Pairs of submaps are compared finely, and all drives are placed at once (`network`), twice.
4. Their heights follow from the ground that they saw, as it lies then (`heights`).
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from fieldgrid.core import ConfigError, Float64, Runner, Threads, quoted, runner
from fieldgrid.field.align.agreement import Agreement, agree
from fieldgrid.field.align.beside import with_beside
from fieldgrid.field.align.comparing import SubmapGroup, fine_matches, whole_scores
from fieldgrid.field.align.disagreement import left_between, wrong_ones
from fieldgrid.field.align.drives import WANDER_SHARE, Role, SubmapDrive, read_drives
from fieldgrid.field.align.heights import HeightCorrections, level
from fieldgrid.field.align.matches import Match
from fieldgrid.field.align.network import solve, turn_sigma_deg
from fieldgrid.field.align.pairs import (
    Overlap,
    SubmapPair,
    bounded,
    for_every_shift,
    of_nearest,
    overlapping,
    placed,
)
from fieldgrid.field.align.report import MapAlignment, summed_up
from fieldgrid.field.align.ridge import across_alone
from fieldgrid.field.align.score import PROBE_DEG, peak
from fieldgrid.field.align.submaps import SubmapImage, draw
from fieldgrid.geometry import Lattice
from fieldgrid.maps import MapFile, Transform, transform_of

if TYPE_CHECKING:
    from distributed import Client

COARSE_M, FINE_M = 0.2, 0.1
"""Sides of the cells in which drives are compared, as wholes and finely."""

REACH_M = 2.5
"""The largest shift that is believed by default; more is scored, to see what else would fit."""

ROUGH_M = 0.1
"""What is left in shifts that were compared in coarse cells alone, from pictures as drives lay."""

BEYOND_M = 2.0

FINE_REACH_M = 1.5

FAR_SIGMAS = 3.0
"""Drives whose best agreement is more than this number of stated errors away contradict what their
receivers state."""

FOUND_WANDER_M = 0.25
"""The largest wander of receivers that are farther off than they state, or what they state where
that is more: most of them have a wrong base."""

FINE_ROUNDS = 2

_Found = TypeVar("_Found")

Progress = Callable[[str, int, int], None]
"""Told of a stage and how far it is: (stage, done, all)."""


def align_map(
    universal: MapFile,
    sessions: Collection[str] | None = None,
    *,
    to: Collection[str] = (),
    datum_from: str | None = None,
    reach_m: float = REACH_M,
    rounds: int = FINE_ROUNDS,
    most_others: int | None = None,
    progress: Progress | None = None,
    jobs: int | None = None,
    scheduler: str | Client | None = None,
) -> MapAlignment:
    """How drives lie against each other, and the transforms that make them coincide; changes
    nothing (`MapFile.set_transforms` does).

    `sessions` are those that may move, all active ones when not given; the others stay, and count
    as far as they are sure. Those in `to`, and `datum_from`, hold: they are right. With `to` no
    further ones take part.
    `reach_m` is the largest shift that is believed; without `rounds` of fine comparison shifts are
    good to a decimetre, in a third of the time. With `most_others` each drive that may move is
    compared with this number of others that may and this number of those that may not, which
    share most ground with it, and not with all.
    `jobs` is the number of threads, all cores when not given; with a `scheduler`, the address of
    one of Dask or a client, the workers of that cluster compare submaps, which are sent to them.
    Raises ConfigError for names that are not in the map, or nothing to align, ClusterError where
    no scheduler answers.
    """
    if not 0.0 < reach_m <= MOST_REACH_M:
        raise ConfigError(f"A reach of {reach_m:g} m cannot be; give 0 to {MOST_REACH_M:g} m.")
    drives = read_drives(universal, _roles(universal, sessions, to, datum_from))
    tell = progress or (lambda stage, done, count: None)
    with runner(jobs, scheduler) as workers:
        found = _aligned(
            _SubmapComparison(drives, reach_m, most_others, tell, workers), drives, rounds
        )
    return with_beside(universal, found)


def _aligned(run: _SubmapComparison, drives: list[SubmapDrive], rounds: int) -> MapAlignment:
    """How drives lie against each other, by their submaps."""
    agreements, coarse = run.compare_as_wholes()
    believed = {(one.a, one.b): one.along for one in agreements if one.doubt is None}
    matched = np.bincount([n for m in coarse for n in (m.a, m.b)], minlength=len(drives)) > 0
    # Who matches nothing has nothing that could place it elsewhere.
    drives = [
        drive if some or drive.role is not Role.MOVES else replace(drive, role=Role.STAYS)
        for drive, some in zip(drives, matched, strict=True)
    ]
    drives = _as_poor_as_found(
        drives,
        {(one.a, one.b): float(np.hypot(*one.shift_m)) for one in agreements if one.doubt is None},
    )
    before = [drive.transform for drive in drives]
    solution, matches = solve(drives, before, coarse), coarse
    for number in range(rounds):
        stage = f"submaps, round {number + 1} of {rounds}"
        matches = run.compare_finely(solution.transforms, believed, stage)
        now = solution.transforms
        solution = solve(drives, now, matches)
        poorer = _as_poor_as_found(drives, left_between(matches, solution.left_m))
        if any(one is not other for one, other in zip(poorer, drives, strict=True)):
            drives = poorer
            solution = solve(drives, now, matches)
    rough_m = 0.0 if rounds else ROUGH_M
    doubtful = {n for one in agreements if one.doubt is not None for n in (one.a, one.b)}
    heights = HeightCorrections((None,) * len(drives), {})
    if rounds:
        heights = level(drives, solution.transforms, doubtful)
    corrected = [
        found or earlier.heights for found, earlier in zip(heights.corrections, before, strict=True)
    ]
    transforms = [
        one if own is one.heights else replace(one, heights=own)
        for one, own in zip(solution.transforms, corrected, strict=True)
    ]
    solution = solution._replace(transforms=tuple(transforms))
    return summed_up(drives, before, agreements, matches, solution, rough_m, heights.kept)


MOST_REACH_M = 20.0


def _as_poor_as_found(
    drives: Sequence[SubmapDrive], between_m: Mapping[tuple[int, int], float]
) -> list[SubmapDrive]:
    """Drives with the errors of their receivers, and larger ones where what lies between two is too
    much for these."""
    apart = {
        (a, b): size
        for (a, b), size in between_m.items()
        if size > FAR_SIGMAS * math.hypot(drives[a].sigma_m, drives[b].sigma_m)
    }
    found = list(drives)
    for n, size in wrong_ones([drive.sigma_m for drive in drives], apart).items():
        sigma_m = max(size / 2.0, drives[n].sigma_m)
        wander_m = max(min(WANDER_SHARE * sigma_m, FOUND_WANDER_M), drives[n].wander_m)
        found[n] = replace(drives[n], sigma_m=sigma_m, wander_m=wander_m)
    return found


def _told(matches: Sequence[Match], along: Float64) -> list[Match]:
    """The matches of two drives without what they say of the shift along a ridge."""
    told = across_alone([one.information for one in matches], along)
    return [one._replace(information=some) for one, some in zip(matches, told, strict=True)]


def _roles(
    universal: MapFile,
    sessions: Collection[str] | None,
    to: Collection[str],
    datum_from: str | None,
) -> dict[str, Role]:
    """The roles of the sessions that take part, as they were added one after the other."""
    active = [info.name for info in universal.sessions() if info.active and info.accepted]
    holding = {*to, *([] if datum_from is None else [datum_from])}
    moving = set(active) - holding if sessions is None else set(sessions)
    for name in (*holding, *moving):
        if name not in active:
            raise ConfigError(
                f"{universal.path} has no session {quoted(name)} with accepted frames in the map; "
                f"it has {', '.join(map(repr, active)) or 'none'}."
            )
    if moving & holding:
        raise ConfigError(
            f"Session {quoted(sorted(moving & holding)[0])} is to move and to hold; say one of "
            "them."
        )
    if not moving:
        held = ", ".join(map(repr, sorted(holding))) or "none"
        raise ConfigError(
            f"There is nothing to align: of {', '.join(map(repr, active)) or 'no session'} in "
            f"{universal.path} none is to move, and to stay in place are: {held}. Append another "
            "drive, or leave one of these out of --to and --datum-from."
        )
    named = dict.fromkeys(moving, Role.MOVES) | dict.fromkeys(holding, Role.HOLDS)
    return {name: named.get(name, Role.STAYS) for name in active if not to or name in named}


def undo_alignment(universal: MapFile, sessions: Collection[str] | None = None) -> list[str]:
    """Put aligned sessions back where they were, bit for bit; returns their names.

    All of them when `sessions` are not given. Raises ConfigError for one that is not aligned.
    """
    aligned = {
        info.name: info.transform.aligned
        for info in universal.sessions()
        if info.transform.aligned is not None
    }
    for name in sessions or ():
        if name not in aligned:
            raise ConfigError(
                f"Session {quoted(name)} of {universal.path} is not aligned; there is nothing to "
                "undo."
            )
    chosen = list(aligned) if sessions is None else [name for name in aligned if name in sessions]
    if not chosen:
        raise ConfigError(f"No session of {universal.path} is aligned; there is nothing to undo.")
    universal.set_transforms({name: transform_of(aligned[name].before) for name in chosen})
    return chosen


class _SubmapComparison:
    """Comparing submaps, by threads of this process or by the workers of a cluster."""

    def __init__(
        self,
        drives: Sequence[SubmapDrive],
        reach_m: float,
        most_others: int | None,
        tell: Progress,
        workers: Runner,
    ) -> None:
        self._drives, self._reach_m, self._most_others = drives, reach_m, most_others
        self._tell, self._workers = tell, workers
        self._local_m = max(f.spec.cell_m for d in drives for s in d.submaps for f in s.frames)

    def compare_as_wholes(self) -> tuple[list[Agreement], list[Match]]:
        """Where two drives each agree, and the matches of those that do without doubt."""
        drawn = self._draw([drive.transform for drive in self._drives], COARSE_M, "drives")
        (pictures,) = drawn
        by_pair = defaultdict(list)
        overlaps: Iterable[Overlap] = self._overlaps(pictures, None)
        if self._most_others is not None:
            moving = [n for n, drive in enumerate(self._drives) if drive.role is Role.MOVES]
            overlaps = of_nearest(overlaps, moving, self._most_others)
        chosen = for_every_shift(overlaps, pictures, self._reach_m)
        pairs = [placed(one, pictures) for one in chosen]
        compare = partial(whole_scores, self._reach_m + BEYOND_M)
        for pair, score in self._each(compare, pairs, drawn, "drives"):
            by_pair[pair.a, pair.b].append((pair, score))
        agreements, matches = [], list[Match]()
        for (a, b), members in sorted(by_pair.items()):
            if a == b:
                matches += [Match(*pair, *peak(score, np.zeros(2))) for pair, score in members]
                continue
            places = np.array([pair.at_m for pair, _ in members])
            both = self._drives[a], self._drives[b]
            sigma_m = math.hypot(*(drive.sigma_m for drive in both))
            turn_deg = math.hypot(*(turn_sigma_deg(drive) for drive in both))
            one = agree(
                a, b, [score for _, score in members], places, sigma_m, turn_deg, self._reach_m,
            )  # fmt: skip
            agreements.append(one)
            if one.doubt is None:
                turn = np.radians(one.turn_deg)
                own = list[Match]()
                for (pair, score), away in zip(members, places - one.at_m, strict=True):
                    near = one.shift_m + turn * np.array([away[1], -away[0]])
                    own.append(Match(*pair, *peak(score, near)))
                matches += _told(own, one.along)
        return agreements, matches

    def compare_finely(
        self,
        transforms: Sequence[Transform],
        believed: Mapping[tuple[int, int], Float64],
        stage: str,
    ) -> list[Match]:
        """The matches of drives that agree, placed by transforms. `believed` are their pairs, with
        the way along which nothing is told."""
        drawn = self._draw(transforms, FINE_M, stage, (0.0, -PROBE_DEG, PROBE_DEG))
        pictures, *_ = drawn
        pairs = [placed(one, pictures) for one in bounded(self._overlaps(pictures, set(believed)))]
        by_pair = defaultdict[tuple[int, int], list[Match]](list)
        for _, one in self._each(partial(fine_matches, FINE_REACH_M), pairs, drawn, stage):
            by_pair[one.a, one.b].append(one)
        nothing = np.zeros(2)
        return [
            match
            for pair, own in by_pair.items()
            for match in _told(own, believed.get(pair, nothing))
        ]

    def _draw(
        self,
        transforms: Sequence[Transform],
        cell_m: float,
        stage: str,
        turns_deg: Sequence[float] = (0.0,),
    ) -> list[list[list[SubmapImage]]]:
        """For each turn the pictures of all submaps by drive, each turned about its own middle."""
        lattice = Lattice(max(cell_m, self._local_m))
        places = [(n, submap) for n, drive in enumerate(self._drives) for submap in drive.submaps]
        pictures: list[list[list[SubmapImage]]] = [[[] for _ in self._drives] for _ in turns_deg]
        # Here, where the frames are: this grows with the drives, and comparing with their pairs.
        drawn = Threads(self._workers.here).in_order(
            lambda place: draw(place[1], transforms[place[0]], lattice, turns_deg), places
        )
        for done, ((n, _), turned) in enumerate(zip(places, drawn, strict=True)):
            for of_turn, picture in zip(pictures, turned, strict=True):
                of_turn[n].append(picture)
            self._tell(f"drawing {stage}", done + 1, len(places))
        return pictures

    def _overlaps(
        self, pictures: Sequence[Sequence[SubmapImage]], believed: set[tuple[int, int]] | None
    ) -> Iterator[Overlap]:
        """What may be compared: not what holds with what holds, nor what is in doubt."""

        def compared(a: int, b: int) -> bool:
            moves = Role.MOVES in (self._drives[a].role, self._drives[b].role)
            return moves and (believed is None or a == b or (a, b) in believed)

        return overlapping(pictures, compared)

    def _each(
        self,
        work: Callable[[SubmapGroup], list[tuple[SubmapPair, _Found]]],
        pairs: Sequence[SubmapPair],
        drawn: Sequence[Sequence[Sequence[SubmapImage]]],
        stage: str,
    ) -> list[tuple[SubmapPair, _Found]]:
        """What work finds for pairs; `drawn` has the pictures for each turn."""
        # Making the spectra of a submap takes as long as a comparison; they serve all of its pairs.
        by_submap = defaultdict[tuple[int, int], list[SubmapPair]](list)
        for pair in pairs:
            by_submap[pair.a, pair.k].append(pair)
        groups = (
            SubmapGroup(
                own, drawn[0][a][k], [[of_turn[p.b][p.l] for of_turn in drawn] for p in own]
            )
            for (a, k), own in by_submap.items()
        )
        results, done = list[tuple[SubmapPair, _Found]](), 0
        found = self._workers.in_order(work, groups)
        for own, of_own in zip(by_submap.values(), found, strict=True):
            results += of_own
            done += len(own)
            self._tell(f"comparing {stage}", done, len(pairs))
        return results
