"""Plugins with their help, and Python functions as deformers."""

import inspect
import pydoc
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

import simod

Points = NDArray[np.float64]


def test_all_plugins_are_there() -> None:
    shipped = {
        "blendshapes", "cage", "control-points", "curve", "displacement-paint", "elastic", "laplacian", "lattice", "rbf",
        "register", "skinning", "smooth", "smooth-handle", "warp",
    }
    assert shipped <= set(simod.plugins) and len(simod.plugins) >= 8
    assert "smooth_handle" in dir(simod.plugins) and simod.plugins.smooth_handle.id == "smooth-handle"
    with pytest.raises(KeyError, match="no plugin 'wrap'"):
        simod.plugins["wrap"]
    assert not hasattr(simod.plugins, "wrap")


def test_help_tells_the_parameters() -> None:
    text = pydoc.plain(pydoc.render_doc(simod.plugins["warp"]))
    assert "operation = 'twist'" in text and "degrees" in text and "from_ = " in text
    signature = inspect.signature(simod.plugins["rbf"])
    assert list(signature.parameters)[0] == "samples" and "regions" in signature.parameters
    assert simod.plugins["warp"].parameters["operation"]["kind"] == "choice"


def test_wrong_parameters(plane: Path) -> None:
    samples = simod.open(plane).sample(500)
    with pytest.raises(simod.ArgumentError, match="no parameter `angel`") as unknown:
        samples.apply("warp", angel=30)
    assert unknown.value.hint == "did you mean `angle`?"
    with pytest.raises(simod.PluginError, match="no plugin `wrap`"):
        samples.apply("wrap")
    with pytest.raises(simod.FormatError, match="half_space|half-space|unknown"):
        samples.apply("rbf", regions=[{"role": "fixed", "shapes": [{"cube": {}}]}])
    with pytest.raises(TypeError, match="no session can hold"):
        samples.apply("warp", angle=1j)
    with pytest.raises(AttributeError):
        samples.apply(3)  # type: ignore[arg-type]
    assert np.array_equal(samples.points, samples.rest) and samples.steps == []


def test_a_function_is_a_deformer(plane: Path, tmp_path: Path) -> None:
    @simod.deformer
    def ripple(
        points: Points, *, height: float = 0.1, waves: int = 3, axis: Literal["x", "z"] = "x", flip: bool = False,
        along: tuple[float, float, float] = (0, 1, 0), file: Path | None = None,
    ) -> Points:
        """Waves across the model.

        And more on them.
        """
        assert points.dtype == np.float64 and isinstance(along, np.ndarray)
        phase = waves * points[:, "xyz".index(axis)]
        points += height * np.sin(-phase if flip else phase)[:, None] * along
        return points

    model = simod.open(plane)
    samples = model.sample(3000)
    expected = ripple(samples.rest.copy(), along=np.array([0, 1, 0]), height=0.2, axis="z")  # type: ignore[arg-type]
    samples.apply(ripple, height=0.2, axis="z")
    assert np.allclose(samples.points, expected, atol=1e-6) and samples.steps == ["ripple"]
    assert samples.undo()
    samples.apply("ripple", height=0.2, axis="z", flip=True, waves=5, along=[1, 0, 0])
    moved = samples.points - samples.rest
    assert np.allclose(moved[:, 0], -0.2 * np.sin(5 * samples.rest[:, 2]), atol=1e-6)
    # The description is a plugin's, with help and with checked values.
    assert simod.plugins["ripple"].summary == "Waves across the model." and "height = 0.1" in str(simod.plugins.ripple.__doc__)
    with pytest.raises(simod.ArgumentError, match="cannot be `y`"):
        samples.apply(ripple, axis="y")
    (tmp_path / "edit.toml").write_text(f"""
[model]
path = "{plane}"
[sampling]
samples = 3000
[[step]]
deform = "ripple"
params = {{ height = 0.2, axis = "z" }}
[[step.region]]
role = "mask"
shapes = [{{ half-space = {{ point = [0, 0, 0], normal = [1, 0, 0] }} }}]
[output]
path = "out.ply"
""")
    report = simod.Session(tmp_path / "edit.toml").run()
    before, after = (np.concatenate(list(simod.open(p).chunks())) for p in (plane, report.output))
    masked = before[:, 0] < -0.4
    assert np.array_equal(after[masked], before[masked])
    free = before[:, 0] > 0.4
    assert np.allclose(after[free, 1], before[free, 1] + 0.2 * np.sin(3 * before[free, 2]), atol=2e-3)
    with pytest.raises(simod.Error, match="samples only|between the samples|deforms samples"):
        simod.Session(tmp_path / "edit.toml").run(measure=True, overwrite=True)


def test_a_map_of_space_can_be_measured(plane: Path, tmp_path: Path) -> None:
    @simod.deformer(id="square", everywhere=True)
    def squared(points: Points, scale: float = 0.5) -> Points:
        return np.stack([points[:, 0], points[:, 1] + scale * points[:, 0] ** 2, points[:, 2]], axis=1)

    (tmp_path / "edit.toml").write_text(f'[model]\npath = "{plane}"\n[[step]]\ndeform = "square"\n')
    report = simod.Session(tmp_path / "edit.toml").run(tmp_path / "out.ply", measure=True)
    assert report.transfer_error is not None and report.transfer_error.max < 1e-4


def test_regions_and_normals_reach_a_function(plane: Path) -> None:
    @simod.deformer
    def pulled(points: Points, *, normals: Points, regions: list[simod.Region]) -> Points:
        assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
        assert [r.role for r in regions] == ["fixed", "handle"]
        fixed, handle = regions
        assert set(fixed.weights) == {0.0, 1.0}
        matrix, shift = handle.transform[:, :3], handle.transform[:, 3]
        return points + handle.weights[:, None] * (points @ matrix.T + shift - points)

    samples = simod.open(plane).sample(2000)
    right = samples.rest[:, 0] > 0.3
    move = {"translate": [0.1, 0.2, 0.3], "axis": [0, 1, 0], "degrees": 90, "pivot": [0.5, 0, 0]}
    samples.apply(
        pulled,
        regions=[{"role": "fixed", "where": samples.rest[:, 0] < -0.3}, {"role": "handle", "where": right, "move": move}],
    )
    x, y, z = (samples.rest[right] - [0.5, 0, 0]).T
    turned = np.stack([z, y, -x], axis=1) + [0.6, 0.2, 0.3]
    assert np.allclose(samples.points[right], turned, atol=1e-5)
    assert np.array_equal(samples.points[~right], samples.rest[~right])


def test_what_a_function_raises_is_the_cause(plane: Path) -> None:
    @simod.deformer
    def broken(points: Points) -> Points:
        raise ZeroDivisionError("on purpose")

    samples = simod.open(plane).sample(500)
    with pytest.raises(simod.PluginError, match="plugin broken: ZeroDivisionError: on purpose") as failed:
        samples.apply(broken)
    assert isinstance(failed.value.__cause__, ZeroDivisionError)
    assert np.array_equal(samples.points, samples.rest) and samples.steps == []
    # The exception is not the cause of later failures.
    with pytest.raises(simod.PluginError) as other:
        samples.apply("missing")
    assert other.value.__cause__ is None


@pytest.mark.parametrize(
    ("returned", "wrong"),
    [
        (np.zeros((3, 3)), "of shape"),
        (None, "not of real numbers"),
        (np.full((500, 3), "x"), "not of real numbers"),
    ],
)
def test_what_a_function_returns_is_checked(plane: Path, returned: object, wrong: str) -> None:
    @simod.deformer
    def odd(points: Points) -> Points:
        return returned  # type: ignore[return-value]

    samples = simod.open(plane).sample(500)
    with pytest.raises(simod.PluginError, match=wrong):
        samples.apply(odd)


def test_a_function_that_gives_nan(plane: Path) -> None:
    @simod.deformer
    def lost(points: Points) -> Points:
        points[7] = np.nan
        return points

    samples = simod.open(plane).sample(500)
    with pytest.raises(simod.PluginError, match="1 of .* not finite, the first at index 7"):
        samples.apply(lost)


def test_annotations_that_nobody_knows(plane: Path) -> None:
    names: dict[str, Any] = {}
    exec("def up(points: 'Unknown', *, by: 'float' = 1) -> 'Unknown':\n    return points + [0, by, 0]", names)
    simod.deformer(names["up"])
    samples = simod.open(plane).sample(500)
    samples.apply("up", by=0.5)
    assert np.allclose(samples.points - samples.rest, [0, 0.5, 0], atol=1e-6)


def test_functions_that_cannot_be_deformers() -> None:
    with pytest.raises(TypeError, match="needs a default"):
        simod.deformer(id="x")(
            lambda points, height: points
        )
    with pytest.raises(TypeError, match="give an id"):
        simod.deformer(lambda points: points)
    with pytest.raises(TypeError, match="first parameter"):
        simod.deformer(id="x")(lambda: np.zeros((1, 3)))
    with pytest.raises(TypeError, match="is no number"):
        simod.deformer(id="x")(lambda points, text="a": points)
    with pytest.raises(TypeError, match="named one by one"):
        simod.deformer(id="x")(lambda points, **more: points)
