"""Core: what every room needs, and nothing that knows fields, drives or maps.

* `errors`: each error that users see, `FieldgridError` first; `documents`, `input_limits` and
  `publish`: untrusted TOML and JSON, bounds of inputs, files that appear whole or not at all.
* `settings`: `BuildSettings` from defaults, a file and flags, each declared once.
* `workers`: work in order on threads (`Threads`) or on a Dask cluster (`Runner`).
* `kernels` compiles inner loops; `entry_points` loads what other packages add.
* `quality` of fixes, `palette` of all pictures, `reasons` of refusals, `utc`, `notebook`.

It computes nothing of a field and opens no recording and no map.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fieldgrid.core.doors import door

if TYPE_CHECKING:
    from fieldgrid.core import notebook as notebook, palette as palette
    from fieldgrid.core.array_types import (
        AnyArray as AnyArray,
        Bool as Bool,
        Complex64 as Complex64,
        Float32 as Float32,
        Float64 as Float64,
        Index as Index,
        Int16 as Int16,
        Int32 as Int32,
        Int64 as Int64,
        UInt8 as UInt8,
        UInt16 as UInt16,
        UInt32 as UInt32,
        UInt64 as UInt64,
    )
    from fieldgrid.core.choices import (
        GearName as GearName,
        MatcherKind as MatcherKind,
        StopCode as StopCode,
        Transfer as Transfer,
    )
    from fieldgrid.core.closing import Closing as Closing
    from fieldgrid.core.documents import (
        MAX_BYTES as MAX_BYTES,
        parse_json as parse_json,
        parse_toml as parse_toml,
    )
    from fieldgrid.core.entry_points import (
        Group as Group,
        PluginRegistry as PluginRegistry,
        load as load,
        plugins as plugins,
    )
    from fieldgrid.core.errors import (
        CalibrationError as CalibrationError,
        ClusterError as ClusterError,
        ConfigError as ConfigError,
        DatumError as DatumError,
        FieldgridError as FieldgridError,
        GnssError as GnssError,
        LackingError as LackingError,
        LimitError as LimitError,
        MapError as MapError,
        MapExistsError as MapExistsError,
        MapWriteError as MapWriteError,
        NoFramesError as NoFramesError,
        NoRouteError as NoRouteError,
        RecordingError as RecordingError,
        TruthError as TruthError,
        counted as counted,
        printable as printable,
        quoted as quoted,
        shortened as shortened,
    )
    from fieldgrid.core.file_locks import let_go as let_go, lock as lock, lock_within as lock_within
    from fieldgrid.core.findings import (
        Figure as Figure,
        Finding as Finding,
        Severity as Severity,
        error as error,
        in_order as in_order,
        info as info,
        warning as warning,
    )
    from fieldgrid.core.input_limits import (
        UnfoldBudget as UnfoldBudget,
        bounded_lines as bounded_lines,
        check_document as check_document,
        check_local_grid as check_local_grid,
        check_rows as check_rows,
        counted_rows as counted_rows,
        file_bytes as file_bytes,
        limits as limits,
    )
    from fieldgrid.core.kernels import (
        kernel as kernel,
        nothing as nothing,
        part_of_kernel as part_of_kernel,
        when_compiling as when_compiling,
    )
    from fieldgrid.core.measured import (
        MeasuredValue as MeasuredValue,
        mean_of as mean_of,
        repeated as repeated,
    )
    from fieldgrid.core.palette import (
        FOUND as FOUND,
        GEARS as GEARS,
        MEASURED as MEASURED,
        OTHER as OTHER,
        ROUTE as ROUTE,
        SHARE as SHARE,
        STATED as STATED,
        UNSEEN as UNSEEN,
        Ramp as Ramp,
        Stop as Stop,
    )
    from fieldgrid.core.publish import (
        NO_HARD_LINKS as NO_HARD_LINKS,
        Draft as Draft,
        DraftFolder as DraftFolder,
        check_place as check_place,
        hold as hold,
        holding as holding,
        made_elsewhere as made_elsewhere,
        mentions as mentions,
        refuse_input as refuse_input,
        replacing as replacing,
        replacing_folder as replacing_folder,
        sync as sync,
        working_beside as working_beside,
        writing as writing,
    )
    from fieldgrid.core.quality import (
        CARRIER as CARRIER,
        CENTIMETRES_M as CENTIMETRES_M,
        CODE as CODE,
        Quality as Quality,
    )
    from fieldgrid.core.reasons import (
        commonest_reason as commonest_reason,
        grouped_reasons as grouped_reasons,
    )
    from fieldgrid.core.settings.declare import (
        DeclaredSetting as DeclaredSetting,
        Flag as Flag,
        Settings as Settings,
        declared as declared,
        first_problem as first_problem,
        setting as setting,
    )
    from fieldgrid.core.settings.models import (
        BuildSettings as BuildSettings,
        DensitySettings as DensitySettings,
        FrameOrigin as FrameOrigin,
        GateLimits as GateLimits,
        GearSpan as GearSpan,
        GridSettings as GridSettings,
        MapSettings as MapSettings,
        PoseSettings as PoseSettings,
        StereoSettings as StereoSettings,
    )
    from fieldgrid.core.settings.resolve import Overrides as Overrides, resolve as resolve
    from fieldgrid.core.utc import (
        MAX_TIME_NS as MAX_TIME_NS,
        MIN_TIME_NS as MIN_TIME_NS,
        utc_text as utc_text,
    )
    from fieldgrid.core.workers.cluster import (
        await_workers as await_workers,
        check_versions as check_versions,
        is_death as is_death,
        result_of as result_of,
        versions as versions,
    )
    from fieldgrid.core.workers.connecting import connected as connected
    from fieldgrid.core.workers.order import (
        Runner as Runner,
        Threads as Threads,
        by_threads as by_threads,
    )
    from fieldgrid.core.workers.place import check_is_here as check_is_here
    from fieldgrid.core.workers.runner import runner as runner
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
