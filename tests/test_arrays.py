"""The checks at the doors, the flags and the error family."""

from __future__ import annotations

import numpy as np
import pytest

from geoposition import errors
from geoposition.arrays import as_components, read_only, require_finite, require_increasing
from geoposition.errors import (
    ArgumentError,
    GeopositionError,
    MissingFileError,
    ProductError,
    SpanError,
    UnsupportedError,
)
from geoposition.flags import Flag, flag_labels, has_result


def test_read_only_is_a_contiguous_copy() -> None:
    source = np.arange(6.0).reshape(2, 3).T
    frozen = read_only(source)
    source[:] = -1
    assert frozen.tolist() == [[0, 3], [1, 4], [2, 5]]
    assert frozen.flags.c_contiguous
    assert frozen.dtype == np.float64
    with pytest.raises(ValueError):
        frozen[0, 0] = 1.0


def test_as_components() -> None:
    assert as_components([1, 2], 2, "x").dtype == np.float64
    assert as_components(np.zeros((4, 0, 3)), 3, "x").shape == (4, 0, 3)
    for bad in (1.0, [1.0], np.zeros((2, 3)), []):
        with pytest.raises(ArgumentError, match=r"points: shape \(\.\.\., 2\) expected, got"):
            as_components(bad, 2, "points")


@pytest.mark.parametrize("bad", ["text", [["a", "b"]], [[1.0, 2.0], [3.0]], None])
def test_what_is_no_number_is_an_argument_error(bad: object) -> None:
    with pytest.raises(ArgumentError, match="points"):
        as_components(bad, 2, "points")  # type: ignore[arg-type]


@pytest.mark.parametrize("shape", [(), (5,), (5, 2), (5, 2, 2)])
def test_require_finite(shape: tuple[int, ...]) -> None:
    good = np.ones(shape)
    assert require_finite(good, "x") is good
    bad = np.ones(shape)
    bad.flat[-1] = np.nan
    with pytest.raises(
        ArgumentError, match=f"x: finite numbers expected, entry {4 if shape else 0}"
    ):
        require_finite(bad, "x")
    assert require_finite(np.empty((0, 3)), "x").shape == (0, 3)


def test_require_increasing() -> None:
    assert require_increasing(np.array([1.0]), "t").tolist() == [1.0]
    with pytest.raises(ArgumentError, match="t: strictly increasing times expected, entry 2"):
        require_increasing(np.array([1.0, 2.0, 2.0, 1.0]), "t")
    for bad in (np.empty(0), np.zeros((1, 1)), np.array(1.0)):
        with pytest.raises(ArgumentError, match="non-empty list"):
            require_increasing(bad, "t")


def test_flags() -> None:
    flags = np.array([[0, 1], [2, 10]], dtype=np.uint8)
    assert flag_labels(flags).tolist() == [["ok", "outside_image"], ["outside_model", "blunder"]]
    assert has_result(flags).tolist() == [[True, True], [False, False]]
    assert [int(flag) for flag in Flag] == list(range(len(Flag)))
    assert flag_labels(np.array(3, dtype=np.uint8)) == "bad_input"


def test_every_error_is_of_the_family_and_a_builtin() -> None:
    kinds = [k for k in vars(errors).values() if isinstance(k, type) and issubclass(k, Exception)]
    assert len(kinds) >= 9
    for kind in kinds:
        assert issubclass(kind, GeopositionError)
        if kind is not GeopositionError:
            assert issubclass(kind, (ValueError, ArithmeticError, OSError))


def test_product_errors_are_one_line() -> None:
    error = ProductError("a.xml", "ROOT/TAG", "a number\n   expected,\tgot 'x'")
    assert str(error) == "a.xml: ROOT/TAG: a number expected, got 'x'"
    assert (error.path, error.place) == ("a.xml", "ROOT/TAG")
    assert str(ProductError("a.xml", "", "gone")) == "a.xml: gone"
    assert isinstance(MissingFileError("a", "", "b"), FileNotFoundError)
    assert str(MissingFileError("a", "", "b")) == "a: b"
    assert isinstance(UnsupportedError("a", "", "b"), ProductError)
    assert "\n" not in str(SpanError("orbit", (1.0, 2.0), (0.0, 1.0)))
