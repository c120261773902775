"""Time to draw meshes at 512 pixels, beside VTK (through Mesa) and matplotlib where they are installed.

All draw the same faces with smooth or flat shades to an array, on this machine's cores, in turns. Writes the section
"pictures" of docs/benchmarks/page.md.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from benchmarks.common import BENCHMARKS, in_turns, table, write_section
from unbend import Surface
from unbend.mesh.shapes import torus
from unbend.render.colours import THEMES
from unbend.render.draw import render_scene
from unbend.render.scene import Field, Scene, SceneMesh
from unbend.render.view import fit_camera, view_axes
from unbend.threads import available_cores

MESHES = {columns * columns // 2 * 2: (columns, columns // 2) for columns in (100, 224, 500)}
PIXELS = 512
TURNS = 3


def main() -> None:
    rows = []
    peers = {"VTK": _vtk, "matplotlib": _matplotlib}
    found = {name: make for name, make in peers.items() if find_spec(name.lower())}
    for columns, lines in MESHES.values():
        surface = torus(columns=columns, rows=lines)
        times = in_turns(
            {"unbend": _ours(surface), "contours": _ours(surface, contours=12), "one": _ours(surface, threads=1)}
            | {name: make(surface) for name, make in found.items()},
            TURNS + 1,
        )
        ours = times["unbend"][0]
        ratios = [f"{times[name][0] / ours:.1f}" if name in times else "not installed" for name in peers]
        rows.append(
            [
                f"{len(surface.faces):,}",
                f"{ours:.2f} s",
                f"{times['contours'][0]:.2f} s",
                f"{times['one'][0]:.2f} s",
                *ratios,
            ]
        )
    header = ["faces", "unbend", "with contours", "on one thread", *(f"{name} / unbend" for name in peers)]
    text = (
        f"**Pictures**: a torus at {PIXELS} x {PIXELS} pixels, from the mesh to an array, on {available_cores()} cores "
        f"at a load of {os.getloadavg()[0]:.0f} (`python -m benchmarks.render.picture`). unbend takes nine samples per "
        "pixel, and finds normals, lights and soft shadows. VTK draws through Mesa's software with eight samples per "
        "pixel and smooth normals; matplotlib fills whole triangles in flat shades, from far to near.\n\n"
    )
    write_section(BENCHMARKS / "page.md", "pictures", text + table(header, rows))


def _ours(surface: Surface, contours: int = 0, threads: int | None = None) -> Callable[[], np.ndarray]:
    field = Field(surface.vertices[:, 2], contours=contours) if contours else None
    size = PIXELS, PIXELS
    camera = fit_camera(surface.vertices, view_axes(35, 30, "z"), size)

    def draw() -> np.ndarray:
        scene = Scene((SceneMesh(surface.vertices, surface.faces, THEMES["light"].surface, field=field),))
        return render_scene(scene, camera, size, THEMES["light"], threads=threads)

    return draw


def _matplotlib(surface: Surface) -> Callable[[], np.ndarray]:
    import matplotlib as mpl  # noqa: PLC0415

    mpl.use("Agg")
    import matplotlib.pyplot as plt  # noqa: PLC0415

    def draw() -> np.ndarray:
        page = plt.figure(figsize=(PIXELS / 100, PIXELS / 100), dpi=100)
        axes = page.add_subplot(projection="3d")
        axes.plot_trisurf(*surface.vertices.T, triangles=surface.faces, linewidth=0, antialiased=False)
        page.canvas.draw()
        pixels = np.array(page.canvas.buffer_rgba())
        plt.close(page)
        return pixels

    return draw


def _vtk(surface: Surface) -> Callable[[], np.ndarray]:
    import vtk  # noqa: PLC0415
    from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy  # noqa: PLC0415

    def draw() -> np.ndarray:
        points, cells = vtk.vtkPoints(), vtk.vtkCellArray()
        points.SetData(numpy_to_vtk(surface.vertices, deep=True))
        cells.SetData(3, numpy_to_vtkIdTypeArray(surface.faces.astype(np.int64).ravel(), deep=True))
        data = vtk.vtkPolyData()
        data.SetPoints(points)
        data.SetPolys(cells)
        normals = vtk.vtkPolyDataNormals()
        normals.SetInputData(data)
        mapper = vtk.vtkPolyDataMapper()
        mapper.SetInputConnection(normals.GetOutputPort())
        actor = vtk.vtkActor()
        actor.SetMapper(mapper)
        renderer, window, reader = vtk.vtkRenderer(), vtk.vtkRenderWindow(), vtk.vtkWindowToImageFilter()
        renderer.AddActor(actor)
        window.SetOffScreenRendering(1)
        window.SetMultiSamples(8)
        window.SetSize(PIXELS, PIXELS)
        window.AddRenderer(renderer)
        window.Render()
        reader.SetInput(window)
        reader.Update()
        return vtk_to_numpy(reader.GetOutput().GetPointData().GetScalars()).copy()

    return draw


if __name__ == "__main__":
    main()
