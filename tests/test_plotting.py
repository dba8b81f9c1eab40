"""Pictures can be drawn, show what they should, and refuse the wrong dimension."""

from __future__ import annotations

import numpy as np
import pytest

from pwaid import HingeProblem, InputError, PWAMap, SimplexMesh, plotting, solve_path


@pytest.fixture
def fold():
    mesh = SimplexMesh.grid([[-1, 1]] * 2, 9)
    return PWAMap(mesh, np.maximum(mesh.points[:, 0], 0.0))


def test_broken_hinges_are_the_fold(fold):
    segments, jump = plotting.broken_hinges(fold)
    assert segments.shape == (8, 2, 2)
    np.testing.assert_allclose(segments[:, :, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(jump, 1.0)


def test_pictures_become_png(fold, small):
    mesh, X, y, X_val, y_val = small
    path = solve_path(
        HingeProblem.from_data(mesh, X, y), lambdas=[1.0, 0.1], tol=1e-2, X_val=X_val, y_val=y_val, mesh=mesh
    )
    figure, axes = plotting.new_figure(2, 2, (8, 6))
    plotting.plot_map(fold, axes[0, 0])
    plotting.plot_shading(fold, axes[0, 1])
    plotting.plot_path(path, axes[1, 0], noise=0.1)
    assert plotting.figure_to_png(figure)[:4] == b"\x89PNG"
    assert plotting.plot_surface(fold).name == "3d"


def test_slices_of_three_inputs():
    mesh = SimplexMesh.grid([[-1, 1]] * 3, 4)
    f = PWAMap(mesh, np.abs(mesh.points[:, 2]))
    figure = plotting.plot_slices(f, levels=[-0.5, 0.0, 0.5], resolution=20)
    titles = [ax.get_title() for ax in figure.axes if ax.get_title()]
    assert len(titles) == 3 and "-0.5" in titles[0]


def test_wrong_dimensions_are_refused(fold):
    line = PWAMap(SimplexMesh.grid([[-1, 1]], 3), np.zeros(3))
    with pytest.raises(InputError, match="the map has 1 inputs; this picture is for 2"):
        plotting.plot_map(line)
    with pytest.raises(InputError, match="slices are for 3"):
        plotting.plot_slices(fold)
