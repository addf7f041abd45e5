"""One exception class per kind of mistake; each message names the file, what is wrong and the remedy."""


class WorkbenchError(Exception):
    """Base of every error that the data, the parameters or the machine are at fault for."""


class ParameterError(WorkbenchError):
    """Values of ``params.yaml`` or of a function call are missing, unknown or out of range."""


class SiteError(WorkbenchError):
    """A site, one of its photographs, its navigation or its control points cannot be used."""


class RasterError(WorkbenchError):
    """A raster cannot be read, written or combined with another one."""


class VectorError(WorkbenchError):
    """A vector file cannot be read, written or combined with a raster."""


class PointsError(WorkbenchError):
    """A point cloud cannot be read or written."""


class CameraError(WorkbenchError):
    """A camera or a pose is impossible or incomplete."""


class OrientationError(WorkbenchError):
    """Photographs cannot be oriented."""


class MatchingError(WorkbenchError):
    """A stereo pair cannot be matched."""


class SurfaceError(WorkbenchError):
    """A surface, terrain or height model cannot be made."""


class MosaicError(WorkbenchError):
    """An orthomosaic cannot be made."""


class ReedError(WorkbenchError):
    """Reed cannot be measured on the given input."""


class TreesError(WorkbenchError):
    """Trees cannot be measured on the given input."""


class AssessmentError(WorkbenchError):
    """A product cannot be compared with its reference."""


class SceneError(WorkbenchError):
    """A virtual scene or flight is impossible."""


class StudyError(WorkbenchError):
    """A study is wrongly designed or cannot continue."""


class PlanningError(WorkbenchError):
    """A mission cannot be flown, or its files cannot be made."""
