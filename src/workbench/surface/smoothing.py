"""Bilateral filter of a surface: smooths within a surface, not across its edges."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import scipy.fft
import xarray as xr

from workbench.compiled import compiled
from workbench.errors import SurfaceError
from workbench.params.bilateral import BilateralParameters
from workbench.rasters import map_tiles

_DEFAULTS = BilateralParameters()
_TAIL = 5.0  # The range kernel has fallen to 4e-6 at five sigma.
_TERMS = 0.72  # Cosines per sigma of the period: the first one that is left out weighs 4e-5.
_LONELY = 0.03  # With fewer like heights in the window the sums cancel: such cells are summed one by one.
_LARGE = 97  # Above this size blurs by FFT are cheaper than separable ones.
_TILE = 1024


def bilateral(
    surface: np.ndarray | xr.DataArray,
    size: int = _DEFAULTS.size,
    sigma_range: float = _DEFAULTS.sigma_range,
    sigma_space: float | None = _DEFAULTS.sigma_space,
    *,
    tile_size: int = _TILE,
) -> np.ndarray | xr.DataArray:
    """Smooth heights with a Gaussian in space and a Gaussian in height [thesis 4.3].

    Every cell becomes the mean of the cells in a square window, weighted by
    ``exp(-distance² / 2 sigma_space²) * exp(-(height - own height)² / 2 sigma_range²)``. Missing
    cells have no weight and stay missing.

    The range kernel is written as a sum of cosines, so that the filter is a sum of plain Gaussian
    blurs: its cost does not grow with the number of cells in the window. The result is within
    1 mm of the sum written down above.

    Parameters
    ----------
    surface
        Heights (rows, columns), metres, NaN = missing; a DataArray keeps its coordinates and attributes.
    size
        Edge of the window, odd, cells.
    sigma_range
        Standard deviation of the Gaussian in height, metres.
    sigma_space
        Standard deviation of the Gaussian in space, cells; a sixth of the size by default.
    tile_size
        Large rasters are worked through in tiles; no seams, the result moves by less than 1 mm.

    Returns
    -------
    ndarray or DataArray
        float32, like the input.

    Raises
    ------
    SurfaceError
        If the window is even, a sigma is not positive, the surface is not two-dimensional or infinite.

    Examples
    --------
    >>> step = np.where(np.arange(9) < 4, 0.0, 30.0) * np.ones((9, 1))
    >>> bool(np.allclose(bilateral(step, 5, 2.0), step, atol=1e-3))
    True
    """
    if size < 1 or size % 2 == 0:
        raise SurfaceError(f"Window of {size} cells has no centre: choose an odd number.")
    sigma_space = size / 6 if sigma_space is None else sigma_space
    if not (sigma_range > 0 and sigma_space > 0 and math.isfinite(sigma_range + sigma_space)):
        raise SurfaceError(f"Sigmas of {sigma_range} m and {sigma_space} cells must be positive.")
    values = np.asarray(surface)
    if values.ndim != 2 or np.isinf(values).any():
        raise SurfaceError(
            f"Surface of shape {values.shape} must be two-dimensional and finite; mark missing cells by NaN."
        )
    reach = size // 2
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_space) ** 2)
    kernel = (kernel / kernel.sum()).astype(np.float32)

    def smooth(part: np.ndarray) -> np.ndarray:
        return _smooth(part, kernel, sigma_range)

    if isinstance(surface, xr.DataArray) and max(values.shape) > tile_size:
        return map_tiles(smooth, surface, margin=reach, tile_size=max(tile_size, reach)).rename(surface.name)
    result = smooth(values)
    return surface.copy(data=result) if isinstance(surface, xr.DataArray) else result


@dataclass(frozen=True)
class _Cosines:
    """The range kernel as ``sum(weight * cos(frequency * difference))``."""

    frequencies: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, spread: float, sigma: float) -> _Cosines:
        """Series that holds for height differences up to ``spread``."""
        period = spread + _TAIL * sigma  # The next copy of the kernel is a tail away from the last height.
        count = math.ceil(_TERMS * period / sigma)
        frequencies = 2 * np.pi / period * np.arange(count + 1)
        weights = 2 * math.sqrt(2 * math.pi) * sigma / period * np.exp(-0.5 * (frequencies * sigma) ** 2)
        weights[0] /= 2
        return cls(frequencies, weights)


def _smooth(values: np.ndarray, kernel: np.ndarray, sigma: float) -> np.ndarray:
    known = np.isfinite(values)
    result = np.full(values.shape, np.nan, np.float32)
    if not known.any():
        return result
    middle = float(np.median(values[known]))
    heights = np.where(known, values - middle, 0).astype(np.float32)
    series = _Cosines.of(_largest_difference(heights, known, len(kernel)), sigma)
    mask = known.astype(np.float32)
    blur = _Blur.of(values.shape, kernel)
    total = blur.real(mask)
    like = np.float32(series.weights[0]) * total
    slope = np.zeros_like(like)
    for (real, imaginary), frequency, weight in zip(
        _fields(heights, mask, series.frequencies[1:], blur),
        series.frequencies[1:],
        series.weights[1:],
        strict=True,
    ):
        _add_term(heights, real, imaginary, float(frequency), float(weight), like, slope)
    lonely = known & (like < _LONELY * total)
    safe = np.where(lonely | ~known, np.float32(1), like)
    result[known] = (values + sigma**2 * slope / safe)[known]
    if lonely.any():
        _sum_directly(
            values.astype(np.float64), np.argwhere(lonely), kernel.astype(np.float64), sigma, result
        )
    return result


def _largest_difference(heights: np.ndarray, known: np.ndarray, size: int) -> float:
    """Largest difference between a cell and any other in its window."""
    window = np.ones((size, size), np.uint8)
    highest = cv2.dilate(np.where(known, heights, np.float32(-np.inf)), window)
    lowest = cv2.erode(np.where(known, heights, np.float32(np.inf)), window)
    return float(max((highest - heights)[known].max(), (heights - lowest)[known].max()))


@dataclass(frozen=True, eq=False)
class _Blur:
    """Gaussian blur over the truncated window; beyond the border is nothing."""

    kernel: np.ndarray
    shape: tuple[int, int]
    transfer: tuple[np.ndarray, np.ndarray] | None

    @classmethod
    def of(cls, shape: tuple[int, int], kernel: np.ndarray) -> _Blur:
        if len(kernel) < _LARGE:
            return cls(kernel, shape, None)
        reach = len(kernel) // 2
        transfers = []
        for length in shape:
            padded = scipy.fft.next_fast_len(length + reach)
            wrapped = np.zeros(padded)
            np.add.at(wrapped, np.arange(-reach, reach + 1) % padded, kernel.astype(np.float64))
            transfers.append(scipy.fft.fft(wrapped).real.astype(np.float32))
        return cls(kernel, shape, (transfers[0], transfers[1]))

    def real(self, field: np.ndarray) -> np.ndarray:
        """Blur of a real field."""
        if self.transfer is None:
            return cv2.sepFilter2D(field, -1, self.kernel, self.kernel, borderType=cv2.BORDER_CONSTANT)
        return np.ascontiguousarray(self.complex(field.astype(np.complex64)).real)

    def complex(self, field: np.ndarray) -> np.ndarray:
        """Blur of real and imaginary part."""
        if self.transfer is None:
            parts = field.view(np.float32).reshape(*field.shape, 2)
            blurred = cv2.sepFilter2D(parts, -1, self.kernel, self.kernel, borderType=cv2.BORDER_CONSTANT)
            return blurred.view(np.complex64)[..., 0]
        down, across = self.transfer
        rows, columns = self.shape
        spectrum = scipy.fft.fft2(field, s=(len(down), len(across)), workers=2)
        spectrum *= down[:, None]
        spectrum *= across
        return scipy.fft.ifft2(spectrum, overwrite_x=True, workers=2)[:rows, :columns]


def _fields(
    heights: np.ndarray, mask: np.ndarray, frequencies: np.ndarray, blur: _Blur
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Blurred cosine and sine of the heights, for each frequency."""
    field = np.empty(heights.shape, np.complex64)
    for frequency in frequencies:
        _turn(heights, mask, float(frequency), field)
        blurred = blur.complex(field)
        yield blurred.real, blurred.imag


@compiled(nogil=True, parallel=False, fastmath=True)
def _turn(heights: np.ndarray, mask: np.ndarray, frequency: float, field: np.ndarray) -> None:
    omega = np.float32(frequency)
    for row in range(heights.shape[0]):
        for column in range(heights.shape[1]):
            angle = omega * heights[row, column]
            field[row, column] = mask[row, column] * complex(math.cos(angle), math.sin(angle))


@compiled(nogil=True, fastmath=True)
def _add_term(
    heights: np.ndarray,
    real: np.ndarray,
    imaginary: np.ndarray,
    frequency: float,
    weight: float,
    like: np.ndarray,
    slope: np.ndarray,
) -> None:
    """Add one cosine to the sum of weights and to its derivative by the own height."""
    omega, share, slant = np.float32(frequency), np.float32(weight), np.float32(weight * frequency)
    for row in range(heights.shape[0]):
        for column in range(heights.shape[1]):
            angle = omega * heights[row, column]
            cosine, sine = math.cos(angle), math.sin(angle)
            like[row, column] += share * (cosine * real[row, column] + sine * imaginary[row, column])
            slope[row, column] += slant * (cosine * imaginary[row, column] - sine * real[row, column])


@compiled(nogil=True)
def _sum_directly(
    values: np.ndarray, cells: np.ndarray, kernel: np.ndarray, sigma: float, result: np.ndarray
) -> None:
    rows, columns = values.shape
    reach = len(kernel) // 2
    for row, column in cells:
        own = values[row, column]
        total = weights = 0.0
        for i in range(max(row - reach, 0), min(row + reach + 1, rows)):
            for j in range(max(column - reach, 0), min(column + reach + 1, columns)):
                value = values[i, j]
                if value == value:
                    weight = kernel[i - row + reach] * kernel[j - column + reach]
                    weight *= math.exp(-0.5 * ((value - own) / sigma) ** 2)
                    total += weight * (value - own)
                    weights += weight
        result[row, column] = own + total / weights
