"""The command line: ``workbench VERB``. No logic here: each verb calls one public function.

Exit codes: 0 done, 1 the data or parameters are at fault, 2 wrong usage.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from workbench.errors import WorkbenchError
from workbench.params import Parameters, load_parameters

app = typer.Typer(
    help="From overlapping aerial photographs to surfaces, true orthophotos, reed and trees.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
console = Console(stderr=True, highlight=False)

SiteOption = Annotated[str, typer.Option("--site", help="Name of the site under data/sites.")]
RootOption = Annotated[Path, typer.Option("--root", help="Folder that holds data/.")]
ParamsOption = Annotated[
    Path | None, typer.Option("--params", help="Parameter file; params.yaml of the root by default.")
]
WherePossible = Annotated[
    bool, typer.Option("--where-possible", help="Without the input that the stage needs, say so and succeed.")
]


def main() -> None:
    """Run the command line; errors of data and parameters become one message and exit code 1."""
    try:
        app()
    except WorkbenchError as error:
        console.print(f"[bold red]{type(error).__name__}[/]", end=" ")
        console.print(str(error), markup=False, soft_wrap=True)
        sys.exit(1)
    except KeyboardInterrupt:
        console.print("Interrupted. Run the same command again to continue.")
        sys.exit(130)


@app.command("new-site")
def new_site(
    name: str,
    photos: Annotated[Path, typer.Option("--photos", help="Folder of photographs (with subfolders).")],
    navigation: Annotated[Path | None, typer.Option(help="Text file of positions and angles.")] = None,
    control: Annotated[Path | None, typer.Option(help="Control file (CSV) or gcp_list.txt.")] = None,
    observations: Annotated[Path | None, typer.Option(help="Control points measured in photographs.")] = None,
    crs: Annotated[str | None, typer.Option(help="CRS of the products, as EPSG:32633.")] = None,
    vertical_datum: Annotated[str | None, typer.Option(help="What heights refer to, in words.")] = None,
    water_level: Annotated[float | None, typer.Option(help="Water level, metres in that datum.")] = None,
    shoreline: Annotated[Path | None, typer.Option(help="Official shoreline: polygon of the lake.")] = None,
    dtm: Annotated[Path | None, typer.Option(help="Terrain raster, for example from lidar.")] = None,
    areas: Annotated[Path | None, typer.Option(help="Areas of interest: polygons with a column aoi.")] = None,
    time_zone: Annotated[str | None, typer.Option(help="Zone of the camera's clock: Europe/Berlin.")] = None,
    navigation_column: Annotated[
        list[str] | None, typer.Option(help="Name of a column of the navigation file: x=Easting; repeatable.")
    ] = None,
    navigation_crs: Annotated[str | None, typer.Option(help="CRS of x and y there, if another.")] = None,
    root: RootOption = Path(),
) -> None:
    """Describe photographs, positions and control as a site: data/sites/NAME/site.yaml."""
    from workbench.site import NavigationFormat, check_site
    from workbench.site import new_site as create

    columns = dict(entry.partition("=")[::2] for entry in navigation_column or ())
    site = create(
        name,
        photos=photos,
        root=root,
        navigation=navigation,
        navigation_format=NavigationFormat(columns, crs=navigation_crs),
        control=control,
        observations=observations,
        crs=crs,
        vertical_datum=vertical_datum,
        water_level=water_level,
        shoreline=shoreline,
        dtm=dtm,
        areas=areas,
        time_zone=time_zone,
    )
    typer.echo(f"{site.folder / 'site.yaml'}: {len(site.photographs)} photographs")
    typer.echo(str(check_site(site)))


@app.command()
def check(site: SiteOption, root: RootOption = Path(), params: ParamsOption = None) -> None:
    """List every problem of a site and of the parameters at once."""
    from workbench.site import check_site, load_site, write_overlap

    loaded = load_site(site, root)
    report = check_site(loaded, _parameters(root, params))
    typer.echo(str(report))
    if report.overlap is not None:
        typer.echo(f"overlap map: {write_overlap(report.overlap, loaded.products / 'check')}")
    if report.errors:
        raise typer.Exit(1)


@app.command()
def simulate(scene: str, root: RootOption = Path(), params: ParamsOption = None) -> None:
    """Photograph a virtual scene and write it as an ordinary site, with its truth beside it."""
    from workbench.virtual import simulate_scene

    site = simulate_scene(scene, root, _parameters(root, params))
    typer.echo(f"{site.folder}: {len(site.photographs)} photographs")


@app.command()
def inputs(site: SiteOption, root: RootOption = Path()) -> None:
    """List what each stage reads of a site, with digests, for DVC to compare."""
    from workbench.site import load_site, write_inputs

    typer.echo(write_inputs(load_site(site, root)))


def _stage_command(verb: str, module: str, function: str, help_text: str) -> None:
    def command(
        site: SiteOption,
        root: RootOption = Path(),
        params: ParamsOption = None,
        where_possible: WherePossible = False,
    ) -> None:
        from workbench.chain import run_stage
        from workbench.site import load_site

        stage = _stage_loader(module, function)
        parameters = _parameters(root, params)
        run_stage(verb, stage, load_site(site, root), parameters, console.print, where_possible)

    command.__doc__ = help_text
    app.command(verb)(command)


STAGES = {
    "orient": ("workbench.orientation", "orient_site", "Camera poses and tie points."),
    "match": ("workbench.matching", "match_site", "Disparities of all stereo pairs."),
    "surface": ("workbench.surface", "surface_site", "Surface, count, spread, provenance, terrain."),
    "mosaic": ("workbench.mosaic", "mosaic_site", "True orthophoto, seamlines, indices."),
    "reed": ("workbench.reed", "reed_site", "Aquatic reed: heights, extent, density, front, status."),
    "trees": ("workbench.trees", "trees_site", "Single trees: mask, tops, crowns."),
    "assess": ("workbench.assessment", "assess_site", "Products against their references."),
    "report": ("workbench.figures", "report_site", "One self-contained HTML report."),
}
"""Module, function and purpose of each stage."""

for _verb, (_module, _function, _help) in STAGES.items():
    _stage_command(_verb, _module, _function, _help)


@app.command("reed-surface")
def reed_surface(
    dsm: Annotated[Path, typer.Argument(help="Raster of heights in metres, from any program.")],
    out: Annotated[Path, typer.Option("--out", help="Folder of the results.")],
    water_level: Annotated[float | None, typer.Option(help="Water level, metres in the same datum.")] = None,
    vertical_datum: Annotated[str | None, typer.Option(help="What heights refer to, in words.")] = None,
    shoreline: Annotated[Path | None, typer.Option(help="Official shoreline: polygon of the lake.")] = None,
    areas: Annotated[Path | None, typer.Option(help="Areas of interest: polygons with a column aoi.")] = None,
    transects: Annotated[Path | None, typer.Option(help="Lines with columns aoi and transect.")] = None,
    spread: Annotated[Path | None, typer.Option(help="Standard deviation of heights in each cell.")] = None,
    field_points: Annotated[Path | None, typer.Option(help="Stem heights and depths (CSV).")] = None,
    plots: Annotated[Path | None, typer.Option(help="Plots of a square metre (CSV).")] = None,
    reference_status: Annotated[Path | None, typer.Option(help="Interpreted status of sections.")] = None,
    params: ParamsOption = None,
) -> None:
    """Aquatic reed of any surface: a DSM, a water level and a shoreline, without a site."""
    from workbench.reed import reed_files

    found = reed_files(
        dsm,
        out,
        _parameters(Path(), params),
        water_level=water_level,
        vertical_datum=vertical_datum,
        shoreline=shoreline,
        areas=areas,
        transects=transects,
        spread=spread,
        field_points=field_points,
        plots=plots,
        reference_status=reference_status,
    )
    for warning in found["warnings"]:
        console.print(f"warning: {warning}", markup=False, soft_wrap=True)
    typer.echo(
        f"{out / 'reed'}: {found['extent_m2']:.0f} m2 of reed, {found['front_m']:.0f} m of front, "
        f"{found['sections']} sections: {found['healthy']} healthy, {found['stressed']} stressed, "
        f"{found['excluded']} excluded"
    )


@app.command()
def plan(
    area: Annotated[Path, typer.Argument(help="Vector file of the area: polygons, any CRS.")],
    out: Annotated[Path, typer.Option("--out", help="Folder of the mission's files.")],
    camera: Annotated[str, typer.Option(help="Name of a camera, as 'DJI FC6310'; a wrong one lists all.")],
    surface: Annotated[
        Path | None, typer.Option(help="Raster that is flown over: terrain or, better, canopy.")
    ] = None,
    purpose: Annotated[
        str | None, typer.Option(help="conifer, broadleaf, reed or orthophoto: takes height and overlaps.")
    ] = None,
    stand_height: Annotated[
        float, typer.Option(help="Of the canopy above ground, m (with a purpose).")
    ] = 0.0,
    highest: Annotated[
        float | None, typer.Option(help="Limit of the height above ground, m (with a purpose).")
    ] = None,
    gsd: Annotated[float | None, typer.Option(help="Ground sampling distance, m.")] = None,
    height: Annotated[float | None, typer.Option(help="Above the surface, m, instead of the GSD.")] = None,
    forward: Annotated[float, typer.Option(help="Overlap along the line, 0..1.")] = 0.8,
    side: Annotated[float, typer.Option(help="Overlap of lines, 0..1.")] = 0.7,
    angle: Annotated[float | None, typer.Option(help="Intersection angle, degrees, not --forward.")] = None,
    direction: Annotated[float | None, typer.Option(help="Of the lines, degrees from north.")] = None,
    constant_altitude: Annotated[bool, typer.Option(help="Do not follow the surface.")] = False,
    home: Annotated[
        tuple[float, float] | None, typer.Option(help="Take-off, east and north in the mission's CRS.")
    ] = None,
    speed: Annotated[float, typer.Option(help="Fastest over ground, m/s.")] = 10.0,
    climb: Annotated[float, typer.Option(help="Up and down, m/s.")] = 3.0,
    battery: Annotated[float, typer.Option(help="Minutes of one battery.")] = 20.0,
    reserve: Annotated[float, typer.Option(help="Share of it that is left at landing.")] = 0.25,
    release_interval: Annotated[float, typer.Option(help="Shortest time between photographs, s.")] = 2.0,
    root: RootOption = Path(),
) -> None:
    """Plan a mission: lines, heights, batteries; files for QGroundControl, MAVLink and Litchi."""
    from workbench.planning import Aircraft, plan_files, reached
    from workbench.planning.purpose import advised_overlaps
    from workbench.planning.reached import summary
    from workbench.virtual.flight_cameras import flight_camera

    asked: dict[str, Any] = {"gsd": gsd, "height": height, "angle": angle}
    asked |= {"forward_overlap": forward, "side_overlap": side}
    if purpose is not None:
        asked, advice = advised_overlaps(
            camera, purpose, stand_height, over_canopy=surface is not None, highest=highest, root=root
        )
        typer.echo(str(advice))
    mission = plan_files(
        area,
        flight_camera(camera),
        out,
        surface=surface,
        direction=direction,
        follow_surface=not constant_altitude,
        home=home,
        aircraft=Aircraft(speed, climb, battery, reserve, release_interval),
        **asked,
    )
    typer.echo(f"{out}: {mission}")
    typer.echo(summary(reached(mission)))


@app.command()
def run(site: SiteOption, root: RootOption = Path(), params: ParamsOption = None) -> None:
    """Run every stage that the site has inputs for, and the report."""
    from workbench.chain import run_site
    from workbench.site import load_site

    stages = {verb: _stage_loader(module, function) for verb, (module, function, _) in STAGES.items()}
    run_site(load_site(site, root), _parameters(root, params), stages, announce=console.print)


@app.command()
def study(
    name: Annotated[
        str,
        typer.Argument(help="A shipped study, a file of one, all, list, findings, or reproducibility."),
    ],
    site: Annotated[
        str | None,
        typer.Option(help="Site whose chain is repeated (reproducibility); a virtual clearing by default."),
    ] = None,
    repeat: Annotated[int | None, typer.Option(help="Repetitions; study.repetitions by default.")] = None,
    surface: Annotated[
        list[str] | None,
        typer.Option(help="Surface of the mosaics, dsm or mesh; repeatable; both by default."),
    ] = None,
    step: Annotated[
        str | None, typer.Option(help="One step of reproducibility, as 2/orient or compare: a stage of DVC.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="The small preset of the study.")] = False,
    workers: Annotated[
        int | None,
        typer.Option(help="Steps at the same time, in processes of their own; one per processor by default."),
    ] = None,
    memory: Annotated[float, typer.Option(help="Memory of all workers together, GB.")] = 16.0,
    estimate: Annotated[bool, typer.Option("--estimate", help="Only say what it would cost.")] = False,
    root: RootOption = Path(),
    params: ParamsOption = None,
) -> None:
    """Run the chain many times: repetitions of one site, or the cells of a designed study."""
    if name == "list":
        from workbench.studies.design import list_studies

        typer.echo(list_studies().to_string(index=False))
        typer.echo("reproducibility: a virtual clearing in two lights, the chain of each repeated")
        return
    if name == "findings":
        from workbench.studies.findings_page import write_findings

        typer.echo(str(write_findings(root)))
        return
    parameters = _parameters(root, params)
    if name == "reproducibility":
        from workbench.site import load_site
        from workbench.studies.repetitions import SURFACES, repeat_chain, repeat_step

        if site is None and step is None:
            _repeat_clearings(root, parameters, quick=quick, repeat=repeat)
            return
        if site is None:
            raise typer.BadParameter("which site? Give --site NAME.")
        loaded, surfaces = load_site(site, root), surface or SURFACES
        if step is not None:
            repeat_step(loaded, parameters, step, repetitions=repeat, surfaces=surfaces)
            return
        repeated = repeat_chain(
            loaded, parameters, repetitions=repeat, surfaces=surfaces, announce=console.print
        )
        typer.echo(f"{repeated.folder}\n{repeated.table.to_string(index=False)}")
        return
    from workbench.studies.design import load_studies
    from workbench.studies.runner import estimate_study, run_studies

    studies = load_studies(name, root, quick=quick)
    if estimate:
        for chosen in studies:
            typer.echo(f"{chosen.name}\n{estimate_study(chosen, root, parameters).to_string(index=False)}")
        return
    for result in run_studies(
        studies, root, parameters, workers=workers, memory_gb=memory, announce=console.print
    ):
        typer.echo(f"{result.folder}: {len(result.table)} rows, {len(result.failed)} cells failed")
    if name == "all":
        _repeat_clearings(root, parameters, quick=quick, repeat=repeat)


def _repeat_clearings(root: Path, parameters: Parameters, *, quick: bool, repeat: int | None) -> None:
    from workbench.studies.clearings import repeat_clearings

    for repeated in repeat_clearings(
        root, parameters, quick=quick, repetitions=repeat, announce=console.print
    ):
        typer.echo(f"{repeated.folder}\n{repeated.table.to_string(index=False)}")


@app.command()
def explore(
    site: SiteOption,
    root: RootOption = Path(),
    params: ParamsOption = None,
    port: Annotated[int, typer.Option(help="Port on this machine.")] = 5006,
    browser: Annotated[bool, typer.Option(help="Open a browser.")] = True,
) -> None:
    """Move every threshold of a site in a browser: surface, pairs, reed, trees, sweeps."""
    from workbench.figures.app import serve_pages, site_pages
    from workbench.site import load_site

    file = params or root / "params.yaml"
    pages = site_pages(
        load_site(site, root),
        _parameters(root, params),
        parameters_file=file if file.exists() else None,
        root=root,
    )
    for page in pages:
        typer.echo(f"http://127.0.0.1:{port}/{page}")
    serve_pages(pages, port=port, show=browser)


@app.command()
def environment() -> None:
    """Versions, processor and threads of this machine, as environment.md documents them."""
    from workbench.environment import describe_environment

    for label, value in describe_environment().items():
        typer.echo(f"{label}: {value}")


@app.command()
def where(root: RootOption = Path(), params: ParamsOption = None) -> None:
    """Print where the reports of the sites in params.yaml are."""
    for site in _parameters(root, params).sites:
        typer.echo(f"report of {site}: {root / 'data' / 'products' / site / 'report' / 'report.html'}")


def _parameters(root: Path, params: Path | None) -> Parameters:
    path = params or root / "params.yaml"
    if params is None and not path.exists():
        console.print(f"{path}: not there, so every parameter has its default.")
        return Parameters()
    return load_parameters(path)


def _stage(module: str, function: str) -> Callable[..., Any]:
    return getattr(importlib.import_module(module), function)


def _stage_loader(module: str, function: str) -> Callable[..., Any]:
    def load_and_run(*arguments: Any) -> Any:
        return _stage(module, function)(*arguments)

    return load_and_run


if __name__ == "__main__":
    main()
