"""Virtual cameras: those of the papers, and a drone."""

from __future__ import annotations

from dataclasses import dataclass, replace

from workbench.cameras import Camera
from workbench.cameras.table import find_sensor
from workbench.errors import SceneError

# name: make and model of the camera table, focal length (mm), tilts to the right (degrees),
# distortion (k1, k2, p1, p2, k3), moves its charge or sensor with the ground.
# The distortions are of the size of good lenses of their kind; metric large formats deliver none.
_CAMERAS = {
    "UltraCam Eagle 80": ("Vexcel", "UltraCam Eagle 80", 79.8, (0.0,), (), True),
    "UltraCam Eagle 210": ("Vexcel", "UltraCam Eagle 210", 210.75, (0.0,), (), True),
    "DMC I": ("Intergraph", "DMC I", 120.0, (0.0,), (), True),
    "DMC II 230": ("Intergraph", "DMC II 230", 92.0, (0.0,), (), True),
    "MACS Hale": ("DLR", "MACS Hale", 51.7, (0.0,), (-0.045, 0.03), False),
    "MACS MAR": ("DLR", "MACS MAR", 51.7, (0.0,), (-0.045, 0.03), False),
    "3K": ("Canon", "Canon EOS-1Ds Mark II", 50.0, (-35.0, 0.0, 35.0), (-0.08, 0.06), False),
    "3K nadir": ("Canon", "Canon EOS-1Ds Mark II", 50.0, (0.0,), (-0.08, 0.06), False),
    "GoPro Hero 7": ("GoPro", "HERO7 Black", 2.99, (0.0,), (-0.24, 0.08), False),
    "Sony NEX-5N": ("Sony", "NEX-5N", 16.0, (0.0,), (-0.05, 0.02), False),
    "Sony NEX-7": ("Sony", "NEX-7", 18.0, (0.0,), (-0.05, 0.02), False),
    "Sony ILCE-7RM2": ("Sony", "ILCE-7RM2", 15.0, (0.0,), (-0.04, 0.02), False),
    "DJI FC6310": ("DJI", "FC6310", 8.8, (0.0,), (-0.01, 0.005), False),
}


@dataclass(frozen=True)
class FlightCamera:
    """A camera, or a rig of cameras that release together, as it is flown."""

    name: str
    """Name in :func:`flight_camera_names`."""
    make: str
    """Maker as in EXIF."""
    model: str
    """Model as in EXIF."""
    focal_length: float
    """Metres."""
    pixel_size: float
    """Edge of a pixel of the delivered photograph on the sensor, metres."""
    full_frame: tuple[int, int]
    """Columns (across track) and rows (along track) of the whole frame: decides overlaps and angles."""
    frame: tuple[int, int]
    """Columns and rows that are kept of its middle."""
    tilts: tuple[float, ...] = (0.0,)
    """Tilt to the right of every camera of the rig, degrees."""
    distortion: tuple[float, ...] = ()
    """Brown-Conrady k1, k2, p1, p2, k3, in OpenCV's order."""
    principal_offset: tuple[float, float] = (0.0, 0.0)
    """Principal point off the middle of the frame, columns and rows, px."""
    compensates_motion: bool = False
    """Forward motion compensation: no motion blur along the track."""

    def reduced(self, factor: float) -> FlightCamera:
        """The whole frame delivered with fewer and larger pixels; footprint and angles stay.

        Raises
        ------
        SceneError
            If the factor is below 1.
        """
        if not factor >= 1:
            raise SceneError(f"Camera {self.name}: reduction {factor} is below 1; photographs only shrink.")
        width, height = (max(round(edge / factor), 1) for edge in self.full_frame)
        offset = (self.principal_offset[0] / factor, self.principal_offset[1] / factor)
        return replace(
            self,
            pixel_size=self.pixel_size * self.full_frame[0] / width,
            full_frame=(width, height),
            frame=(width, height),
            principal_offset=offset,
        )

    def cropped(self, frame: tuple[int, int]) -> FlightCamera:
        """Only the middle of every photograph; overlaps and angles follow the whole frame.

        Raises
        ------
        SceneError
            If the part is larger than the frame.
        """
        if frame[0] > self.full_frame[0] or frame[1] > self.full_frame[1] or min(frame) < 16:
            raise SceneError(
                f"Camera {self.name}: {frame[0]} x {frame[1]} pixels cannot be cut out of "
                f"{self.full_frame[0]} x {self.full_frame[1]}: use 16 or more, and no more than that."
            )
        return replace(self, frame=(int(frame[0]), int(frame[1])))

    @property
    def camera(self) -> Camera:
        """Inner orientation of the delivered photographs; all cameras of a rig are alike."""
        return Camera.from_focal_length(
            f"{self.make} {self.model}",
            *self.frame,
            focal_length=self.focal_length,
            pixel_size=self.pixel_size,
            distortion=self.distortion,
            principal_offset=self.principal_offset,
        )

    @property
    def folders(self) -> tuple[str, ...]:
        """Folder of the photographs of every camera of the rig; one empty name for a single camera."""
        if len(self.tilts) == 1:
            return ("",)
        names = {-1: "left", 0: "nadir", 1: "right"}
        return tuple(names[(tilt > 0) - (tilt < 0)] for tilt in self.tilts)


def flight_camera_names() -> list[str]:
    """Names that :func:`flight_camera` knows."""
    return sorted(_CAMERAS)


def flight_camera(name: str, *, reduction: float = 1.0, frame: tuple[int, int] | None = None) -> FlightCamera:
    """A virtual camera: pixel size and frame from the camera table, lens from the papers.

    Parameters
    ----------
    name
        One of :func:`flight_camera_names`.
    reduction
        Factor by which the whole photograph is reduced (1 keeps all pixels).
    frame
        Columns and rows kept of the middle of the (reduced) photograph.

    Raises
    ------
    SceneError
        If the camera is unknown, or the reduction or the frame is impossible.
    """
    if name not in _CAMERAS:
        raise SceneError(f"Camera {name} is unknown: choose from {', '.join(flight_camera_names())}.")
    make, model, focal, tilts, distortion, compensated = _CAMERAS[name]
    sensor = find_sensor(make, model)
    if sensor is None:
        raise SceneError(f"Camera {name}: {make} {model} is not in the camera table.")
    whole = (sensor.pixels_wide, sensor.pixels_high)
    camera = FlightCamera(
        name,
        make,
        model,
        focal / 1000,
        sensor.sensor_width / sensor.pixels_wide,
        whole,
        whole,
        tilts,
        distortion,
        compensates_motion=compensated,
    )
    if reduction != 1:
        camera = camera.reduced(reduction)
    return camera if frame is None else camera.cropped(frame)
