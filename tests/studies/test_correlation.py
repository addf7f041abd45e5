import numpy as np
import pandas as pd
import pytest
from scipy.stats import pearsonr, spearmanr

from workbench.errors import StudyError
from workbench.studies import local_correlation


def slow(a, b, window, method):
    """An independent implementation: pad with NaN, drop pairs, scipy."""
    reach = window // 2
    a, b = (np.pad(x.astype(float), reach, constant_values=np.nan) for x in (a, b))
    out = np.full([n - 2 * reach for n in a.shape], np.nan)
    measure = {"pearson": pearsonr, "spearman": spearmanr}[method]
    for i, j in np.ndindex(*out.shape):
        x, y = a[i : i + window, j : j + window].ravel(), b[i : i + window, j : j + window].ravel()
        keep = np.isfinite(x) & np.isfinite(y)
        x, y = x[keep], y[keep]
        if keep.sum() >= 3 and len(set(x)) > 1 and len(set(y)) > 1:
            out[i, j] = measure(x, y).statistic
    return out


@pytest.mark.parametrize("method", ["pearson", "spearman"])
@pytest.mark.parametrize("window", [3, 5, 7])
def test_agrees_with_scipy_window_by_window(method, window):
    random = np.random.default_rng(window)
    a = random.integers(0, 12, (17, 14)).astype(float)  # small integers: ties are frequent
    b = a + random.integers(-3, 4, a.shape)
    a[3:6, 4:9] = np.nan
    b[0, 0], b[10:15, 0:4] = np.nan, 7.0
    result = local_correlation(a, b, window, method)
    np.testing.assert_allclose(result, slow(a, b, window, method), atol=1e-12)


def test_missing_centre_has_a_value_and_a_lonely_pair_has_none():
    a = np.arange(25.0).reshape(5, 5)
    a[2, 2] = np.nan
    assert local_correlation(a, a, 3)[2, 2] == pytest.approx(1)
    alone = np.full((5, 5), np.nan)
    alone[0, 0], alone[0, 1] = 1, 2
    assert np.isnan(local_correlation(alone, alone, 3)).all()


def test_no_variance_gives_no_value_however_large_the_numbers():
    a = np.full((6, 6), 0.1 + 1e9)
    assert np.isnan(local_correlation(a, np.random.default_rng(0).random((6, 6)), 3)).all()
    steep = 1e9 + np.arange(36.0).reshape(6, 6)
    np.testing.assert_allclose(local_correlation(steep, -steep, 3), -1, atol=1e-9)


def test_bands_are_not_mixed():
    random = np.random.default_rng(1)
    a, b = random.random((2, 3, 9, 8))
    together = local_correlation(a, b, 5)
    for band in range(3):
        np.testing.assert_array_equal(together[band], local_correlation(a[band], b[band], 5))


def test_tiles_have_no_seams():
    random = np.random.default_rng(2)
    a, b = random.random((2, 40, 30))
    whole = local_correlation(a, b, 5)
    part = local_correlation(a[8:24], b[8:24], 5)[2:-2]
    np.testing.assert_array_equal(whole[10:22], part)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"window": 4}, "odd"),
        ({"window": -1}, "odd"),
        ({"method": "kendall"}, "choose"),
        ({"b": np.zeros((3, 4))}, "align"),
    ],
)
def test_bad_input_is_named(change, message):
    arguments = {"a": np.zeros((3, 3)), "b": np.zeros((3, 3)), "window": 3, "method": "pearson"} | change
    with pytest.raises(StudyError, match=message):
        local_correlation(**arguments)


def test_pandas_agrees_on_ranks():
    a, b = np.random.default_rng(3).integers(0, 5, (2, 3, 3)).astype(float)
    expected = pd.Series(a.ravel()).corr(pd.Series(b.ravel()), method="spearman")
    assert local_correlation(a, b, 3, "spearman")[1, 1] == pytest.approx(expected, abs=1e-12)
