"""glTF files as meshes: their triangles against those of trimesh, and files that would hurt."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from deepbots_cli.diagnostics import Findings
from deepbots_cli.geometry import mesh_triangles
from deepbots_cli.robots.gltf import FaultyGltfError, placed_triangles, read_gltf
from deepbots_cli.robots.meshes import MAX_BYTES, mesh_bounds
from deepbots_cli.robots.model import Mesh
from deepbots_cli.robots.reader import read

POINTS = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 2, 0)
DOCUMENT: dict[str, Any] = {
    "asset": {"version": "2.0"},
    "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0, "translation": [0, 0, 3]}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "buffers": [{"byteLength": 36}],
}


def glb(document: dict[str, Any] = DOCUMENT, buffer: bytes = POINTS) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(buffer), b"BIN\0") + buffer
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def with_mesh(folder: Path, name: str) -> tuple[Mesh | None, list[str]]:
    text = (
        '<robot name="r"><link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
        f'<collision><geometry><mesh filename="{name}"/></geometry></collision></link></robot>'
    )
    (folder / "r.urdf").write_text(text)
    findings = Findings()
    robot = read(folder / "r.urdf", "r.urdf", findings)
    shape = robot.model.links[0].collisions[0].shape if robot else None
    return shape if isinstance(shape, Mesh) else None, [finding.headline for finding in findings]


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_a_file_of_trimesh_gives_its_triangles(tmp_path: Path, suffix: str):
    scene = trimesh.Scene()
    turned = trimesh.transformations.rotation_matrix(0.5, [1, 2, 3], [0.1, 0.2, 0.3])
    scene.add_geometry(trimesh.creation.box((1, 2, 3)), transform=turned)
    scene.add_geometry(trimesh.creation.icosphere(2), transform=trimesh.transformations.scale_matrix(0.2))
    if suffix == "glb":
        (tmp_path / "m.glb").write_bytes(scene.export(file_type="glb"))
    else:
        for name, content in scene.export(file_type="gltf").items():
            (tmp_path / name.replace("model.gltf", "m.gltf")).write_bytes(content)
    mesh, headlines = with_mesh(tmp_path, f"m.{suffix}")
    assert headlines == []
    assert mesh is not None
    expected = scene.to_mesh()
    corners = mesh_triangles(mesh)
    assert corners.shape == expected.triangles.shape
    assert np.sort(corners.sum((1, 2))) == pytest.approx(np.sort(expected.triangles.sum((1, 2))), abs=1e-5)
    assert np.ravel(mesh_bounds(mesh)) == pytest.approx(expected.bounds.ravel(), abs=1e-6)


def test_buffers_in_the_text_and_beside_the_file_give_the_same(tmp_path: Path):
    uri = "data:application/octet-stream;base64," + base64.b64encode(POINTS).decode()
    for name, address in (("a.gltf", uri), ("b.gltf", "b.bin")):
        document = {**DOCUMENT, "buffers": [{"byteLength": 36, "uri": address}]}
        (tmp_path / name).write_text(json.dumps(document))
    (tmp_path / "b.bin").write_bytes(POINTS)
    first, second = (read_gltf(tmp_path / name, MAX_BYTES) for name in ("a.gltf", "b.gltf"))
    assert first == second
    ((part, rows),) = placed_triangles(first)
    assert list(part.moved(rows)) == [0, 0, 3, 1, 0, 3, 0, 2, 3]


def test_strips_and_fans_are_triangles():
    for mode, corners in ((5, [0, 1, 2, 2, 1, 3]), (6, [0, 1, 2, 0, 2, 3])):
        document = json.loads(json.dumps(DOCUMENT))
        document["meshes"][0]["primitives"][0]["mode"] = mode
        document["accessors"][0]["count"] = 4
        ((part, _),) = placed_triangles(glb(document, POINTS + struct.pack("<3f", 1, 1, 1)))
        assert list(part.corners) == corners


def changed(*path: str | int, to: Any) -> dict[str, Any]:
    document = json.loads(json.dumps(DOCUMENT))
    node = document
    for step in path[:-1]:
        node = node[step]
    node[path[-1]] = to
    return document


LOOP = {"nodes": [{"children": [0], "mesh": 0}]}
FAULTS = {
    "no JSON": b"glTF" + struct.pack("<II", 2, 20) + struct.pack("<I4s", 0, b"JSON"),
    "a huge declared length": glb()[:8] + struct.pack("<I", 0xFFFFFFFF) + glb()[12:],
    "a part longer than the file": glb()[:12] + struct.pack("<I", 0x7FFFFFFF) + glb()[16:],
    "a count of billions": glb(changed("accessors", 0, "count", to=4_000_000_000)),
    "a negative place": glb(changed("bufferViews", 0, "byteOffset", to=-36)),
    "an index beyond": glb(changed("meshes", 0, "primitives", 0, "attributes", "POSITION", to=7)),
    "a node that holds itself": glb({**DOCUMENT, **LOOP}),
    "a buffer outside": glb(changed("bufferViews", 0, "buffer", to=1)),
    "a compressed mesh": glb({**DOCUMENT, "extensionsRequired": ["KHR_draco_mesh_compression"]}),
    "a position that is text": glb(changed("nodes", 0, "translation", to=["x", 0, 0])),
    "deep JSON": struct.pack("<4sII", b"glTF", 2, 20 + 100_000)
    + struct.pack("<I4s", 100_000, b"JSON")
    + b"[" * 100_000,
    "a vertex that is not finite": glb(buffer=struct.pack("<9f", *[float("nan")] * 9)),
    "nothing drawn": glb(changed("meshes", 0, "primitives", 0, "mode", to=1)),
}


@pytest.mark.parametrize("case", FAULTS)
def test_a_glb_file_that_would_hurt_is_one_finding(tmp_path: Path, case: str):
    (tmp_path / "m.glb").write_bytes(FAULTS[case])
    mesh, headlines = with_mesh(tmp_path, "m.glb")
    assert mesh is None
    assert len(headlines) == 1


@pytest.mark.parametrize(
    "uri", ["../secret.bin", "/etc/passwd", "http://x.org/b.bin", "link.bin", "gone.bin"]
)
def test_no_buffer_outside_the_folder_of_a_gltf_file_is_opened(tmp_path: Path, uri: str):
    (tmp_path / "secret.bin").write_bytes(POINTS)
    folder = tmp_path / "robot"
    folder.mkdir()
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    (folder / "m.gltf").write_text(json.dumps({**DOCUMENT, "buffers": [{"byteLength": 36, "uri": uri}]}))
    with pytest.raises(FaultyGltfError, match=r"outside its folder|does not exist beside it"):
        read_gltf(folder / "m.gltf", MAX_BYTES)
