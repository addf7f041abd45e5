"""A scene as an ordinary site: photographs, navigation, control, field campaign, and truth beside it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from ruamel.yaml import YAML

from workbench import __version__
from workbench.errors import SceneError
from workbench.params import Parameters, SimulateParameters
from workbench.rasters import Grid
from workbench.site import Observation, Site, load_site, new_site
from workbench.site.files import write_text
from workbench.virtual import site_files
from workbench.virtual.campaign import ReedCampaign, survey_reed
from workbench.virtual.flight import Disturbance, Exposure, Flight, NavigationErrors, plan_flight
from workbench.virtual.flight_cameras import flight_camera
from workbench.virtual.flight_spec import FlightSpec
from workbench.virtual.optics import Optics
from workbench.virtual.photograph import (
    Conditions,
    describe_exposure,
    encode_photograph,
    photograph_suffix,
    take_photograph,
)
from workbench.virtual.scene import Scene, build_scene, load_scene
from workbench.virtual.survey import scan_stems, survey_targets
from workbench.virtual.truth import scene_truth
from workbench.virtual.wind import Wind

_OVERRIDES = ("camera", "frame", "gsd", "forward_overlap", "side_overlap", "strips", "direction", "wind")


def simulate_scene(
    name: str | Path,
    root: Path | str = ".",
    parameters: Parameters | None = None,
    *,
    flight_overrides: Mapping[str, Any] | None = None,
    seed: int | None = None,
    site_name: str | None = None,
) -> Site:
    """Photograph a scene and write all that a real site has, and ``truth/`` beside it.

    Photographs that are complete and would come out the same are kept, so that an interrupted
    simulation continues where it stopped. Same scene, parameters and seed, same bytes.

    Parameters
    ----------
    name
        Scene of the package, or path of a YAML file.
    root
        Folder that holds ``data/``.
    parameters
        Section ``simulate`` is read; defaults if None.
    flight_overrides
        Fields of :class:`FlightSpec` instead of the scene's, for studies.
    seed
        Instead of the one in the parameters.
    site_name
        Name of the site; that of the scene by default.

    Raises
    ------
    SceneError
        If scene or flight are impossible (before anything is rendered), or a real site has this name.
    SiteError
        If the folder cannot be written.
    """
    settings = (parameters or Parameters()).simulate
    if seed is not None:
        settings = settings.model_copy(update={"seed": seed})
    spec = load_scene(name)
    plan = flight_of(spec.flight, settings, flight_overrides)
    folder = Path(root) / "data" / "sites" / (site_name or spec.name)
    if (folder / "site.yaml").exists() and not (folder / "truth").is_dir():
        raise SceneError(f"{folder} is a real site: choose another name for the virtual one.")
    scene = build_scene(spec)
    flight = fly_scene(scene, plan, settings)
    (folder / "truth").mkdir(parents=True, exist_ok=True)
    (folder / "site.yaml").unlink(missing_ok=True)  # A description stands for a complete simulation.
    conditions = conditions_of(plan, settings)
    observations = _take_all(scene, flight, conditions, settings, folder)
    _write_site(scene, flight, plan, settings, observations, folder)
    return load_site(folder.name, root)


def flight_of(
    spec: FlightSpec, settings: SimulateParameters, overrides: Mapping[str, Any] | None = None
) -> FlightSpec:
    """The flight of a scene with the values that parameters and overrides put in their place.

    Raises
    ------
    SceneError
        If an override is unknown or out of range.
    """
    values = spec.model_dump()
    stated = {key: getattr(settings, key) for key in _OVERRIDES if getattr(settings, key) is not None}
    stated |= dict(overrides or {})
    # Height and GSD exclude each other, and so do the frame of one camera and another camera.
    if "height" in stated and "gsd" not in stated:
        values["gsd"] = None
    if "gsd" in stated and "height" not in stated:
        values["height"] = None
    if stated.get("camera", spec.camera) != spec.camera:
        values |= {"frame": None, "reduction": 1.0}
    try:
        return FlightSpec(**(values | stated))
    except ValidationError as error:
        problems = "; ".join(f"{'.'.join(map(str, p['loc']))}: {p['msg']}" for p in error.errors())
        raise SceneError(f"The flight is impossible: {problems}.") from error


def fly_scene(scene: Scene, plan: FlightSpec, settings: SimulateParameters) -> Flight:
    """Plan the flight of a scene at the height of its open ground.

    Raises
    ------
    SceneError
        As :func:`plan_flight`.
    """
    camera = flight_camera(plan.camera, reduction=plan.reduction, frame=plan.frame)
    west, south, east, north = scene.extent
    x, y = np.meshgrid(np.linspace(west, east, 40), np.linspace(south, north, 40))
    ground = scene.ground_z(x.ravel(), y.ravel())
    if scene.water_level is not None:
        ground = np.maximum(ground, scene.water_level)
    roofs = [float(scene.buildings.ridge_z.max())] if len(scene.buildings) else []
    tops = [float(scene.trees.top_z.max())] if len(scene.trees) else []
    return plan_flight(
        scene.extent,
        camera,
        ground=round(float(np.median(ground)), 2),
        start=plan.time,
        forward_overlap=plan.forward_overlap,
        side_overlap=plan.side_overlap,
        gsd=plan.gsd,
        height=plan.height,
        direction=plan.direction,
        strips=plan.strips,
        run_in=plan.run_in,
        crossing=plan.crossing,
        speed=plan.speed,
        highest=max([float(ground.max()), *roofs, *tops]),
        disturbance=Disturbance(
            settings.trigger_jitter, settings.attitude_disturbance, settings.track_disturbance
        ),
        errors=NavigationErrors(plan.gnss_sd, plan.attitude_sd, settings.bias_share, settings.drift_share),
        seed=settings.seed,
    )


def conditions_of(plan: FlightSpec, settings: SimulateParameters) -> Conditions:
    """Optics, wind and light of a flight."""
    optics = Optics(
        settings.point_spread,
        settings.vignetting,
        settings.exposure_time,
        settings.readout_time,
        settings.brightness,
        settings.full_well,
        settings.read_noise,
    )
    return Conditions(
        optics,
        Wind(plan.wind, plan.wind_direction, seed=settings.seed),
        plan.cloudiness,
        settings.supersampling,
        settings.near_infrared,
        settings.seed,
    )


def _take_all(
    scene: Scene, flight: Flight, conditions: Conditions, settings: SimulateParameters, folder: Path
) -> tuple[Observation, ...]:
    """Take every photograph that is not there yet, and measure the targets in all of them."""
    suffix = photograph_suffix(conditions.near_infrared)
    records = folder / "truth" / "photographs"
    _clear_others({exposure.name for exposure in flight.exposures}, suffix, records, folder)
    observations = []
    with _progress(scene.spec.name, len(flight.exposures)) as advance:
        for exposure in flight.exposures:
            path = folder / "photographs" / (exposure.name + suffix)
            exif = describe_exposure(flight, exposure, scene.crs, conditions.optics)
            digest = _digest(scene, flight, exposure, conditions, settings, exif)
            noted = records / f"{exposure.name}.json"
            record = site_files.read_record(noted)
            if record.get("digest") != digest or not path.exists():
                taken = take_photograph(scene, flight, exposure, conditions)
                site_files.write_bytes(encode_photograph(taken.pixels, exif, settings.jpeg_quality), path)
                if settings.truth_per_photograph:
                    site_files.write_view(taken.view, records / f"{exposure.name}.npz")
                record = {"digest": digest, "targets": taken.targets}
                site_files.write_record(record, noted)
            rng = np.random.default_rng([conditions.seed, 44, exposure.release, exposure.mount])
            for target, (column, row) in sorted(record["targets"].items()):
                c, r = np.array([column, row]) + rng.normal(0, settings.measuring_sd, 2)
                observations.append(Observation(target, exposure.name + suffix, float(c), float(r)))
            advance()
    return tuple(observations)


def _write_site(
    scene: Scene,
    flight: Flight,
    plan: FlightSpec,
    settings: SimulateParameters,
    observations: tuple[Observation, ...],
    folder: Path,
) -> None:
    rng = np.random.default_rng([settings.seed, 45])
    points = survey_targets(
        scene,
        rng=rng,
        sd_xy=settings.survey_sd_xy,
        sd_z=settings.survey_sd_z,
        check_every=settings.check_every,
    )
    campaign = survey_reed(
        scene,
        rng=np.random.default_rng([settings.seed, 46]),
        line_length=settings.line_length,
        transect_spacing=settings.transect_spacing,
        point_spacing=settings.point_spacing,
        height_reading=settings.height_reading,
        gnss_error=settings.field_gnss_error,
    )
    _write_truth(scene, flight, campaign, settings, folder)
    control, measured = site_files.write_survey(points, observations, folder)
    suffix = photograph_suffix(settings.near_infrared)
    navigation = folder / "navigation.txt"
    navigation.unlink(missing_ok=True)
    if plan.navigation:
        site_files.write_navigation(flight, scene, suffix, navigation)
    site = new_site(
        folder.name,
        photos=folder / "photographs",
        root=folder.parents[2],
        navigation=navigation if plan.navigation else None,
        control=control if points else None,
        observations=measured if observations else None,
        crs=scene.spec.crs,
        vertical_datum=scene.vertical_datum,
        time_zone="UTC",
        water_level=scene.water_level,
        **_references(scene, campaign, settings, folder),  # type: ignore[arg-type]
    )
    _state_cameras(site, flight, plan)


def _references(
    scene: Scene, campaign: ReedCampaign, settings: SimulateParameters, folder: Path
) -> dict[str, Path]:
    files: dict[str, Path] = {}
    if scene.shoreline is not None:
        files["shoreline"] = site_files.write_shoreline(scene, folder)
    if len(campaign.points):
        files |= site_files.write_campaign(campaign, folder)
    trees = scan_stems(
        scene,
        rng=np.random.default_rng([settings.seed, 47]),
        sd=settings.scan_sd,
        min_dbh_broadleaf=settings.min_dbh_broadleaf,
        min_dbh_conifer=settings.min_dbh_conifer,
    )
    if len(trees):
        files["reference_trees"] = site_files.write_trees(trees, folder / "reference_trees.gpkg")
    return files


def _write_truth(
    scene: Scene, flight: Flight, campaign: ReedCampaign, settings: SimulateParameters, folder: Path
) -> None:
    grid = Grid.from_bounds(scene.crs, scene.extent, settings.truth_resolution)
    site_files.write_truth(scene, scene_truth(scene, grid), campaign, flight, folder / "truth")


def _state_cameras(site: Site, flight: Flight, plan: FlightSpec) -> None:
    """Answer what a certificate of the cameras and the log of the flight answer."""
    path = site.folder / "site.yaml"
    yaml = YAML()
    description = yaml.load(path.read_text(encoding="utf-8"))
    camera = flight.camera
    for entry in description["cameras"].values():
        entry["focal_length_mm"] = round(camera.focal_length * 1000, 4)
        entry["sensor_width_mm"] = round(camera.pixel_size * camera.frame[0] * 1000, 4)
        entry["source"] = "stated"
        if plan.calibrated:
            entry["distortion"] = [float(value) for value in camera.distortion]
    description["flight"]["platform"] = camera.name
    description["flight"]["wind"] = f"{plan.wind:g} m/s from {plan.wind_direction:g} degrees"
    description["flight"]["weather"] = f"cloudiness {plan.cloudiness:g} of 1"
    out = _Text()
    yaml.dump(description, out)
    write_text(out.text, path)


class _Text:
    """What a YAML writer wrote."""

    def __init__(self) -> None:
        self.text = ""

    def write(self, text: bytes | str) -> None:
        self.text += text.decode() if isinstance(text, bytes) else text


def _clear_others(names: set[str], suffix: str, records: Path, folder: Path) -> None:
    """Remove photographs of an earlier, different flight over the same site."""
    if not records.is_dir():
        return
    for noted in sorted(records.rglob("*.json")):
        name = noted.relative_to(records).with_suffix("").as_posix()
        for other in (".jpg", ".tif"):
            if name not in names or other != suffix:
                (folder / "photographs" / (name + other)).unlink(missing_ok=True)
        if name not in names:
            noted.unlink()
            noted.with_suffix(".npz").unlink(missing_ok=True)


def _digest(
    scene: Scene,
    flight: Flight,
    exposure: Exposure,
    conditions: Conditions,
    settings: SimulateParameters,
    exif: bytes,
) -> str:
    """Of everything that a photograph depends on."""
    facts = {
        "scene": scene.spec.model_dump(mode="json", exclude={"flight", "title"}),
        "camera": asdict(flight.camera),
        "pose": [exposure.pose.rotation.tolist(), exposure.pose.centre.tolist()],
        "velocity": exposure.velocity.tolist(),
        "moment": [exposure.time.isoformat(), exposure.release, exposure.mount, flight.ground],
        "conditions": asdict(conditions),
        "files": [settings.jpeg_quality, settings.truth_per_photograph, exif.hex(), __version__],
    }
    text = json.dumps(facts, sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


@contextmanager
def _progress(title: str, total: int) -> Iterator[Any]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task(f"photographs of {title}", total=total)
        yield lambda: progress.advance(task)
