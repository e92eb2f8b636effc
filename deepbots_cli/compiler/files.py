"""Files of the world: meshes of objects and of the ground, pictures of heights. Each is checked before anything builds it."""

from __future__ import annotations

import hashlib
from pathlib import Path as FilePath

from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.diagnostics import Fix
from deepbots_cli.document import files
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.expressions.types import SPACE, Context
from deepbots_cli.reading import read_at_most
from deepbots_cli.robots import meshes
from deepbots_cli.robots.meshes import measure
from deepbots_cli.robots.model import Mesh
from deepbots_cli.terrain import png

MOST_TRIANGLES = 200_000
_SMALLEST, _SMALL, _LARGE, _LARGEST = 1e-5, 1e-4, 1e3, 1e6  # m; beyond the inner two a mesh is probably in another unit


def mesh(namespace: Namespace, path: Path, reference: str, scale: object) -> Mesh | None:
    """The mesh file at `path`, which holds `file` and `scale`; None after a finding."""
    values, place = namespace.values, (*path, "file")
    factors = values.numbers(
        (*path, "scale"), scale if scale is not None else "1 1 1", NUMBER, SPACE, ParameterScope(namespace, Context.FIXED)
    )
    found = _located(namespace, place, reference)
    if found is None or factors is None:
        return None
    loaded = meshes.Meshes(lambda _reference: found).load(reference)
    if isinstance(loaded, meshes.Refusal):
        values.findings.add("DB301", values.span(place), loaded.why, help=loaded.help)
        return None
    if 0.0 in factors:
        values.findings.add("DB105", values.span((*path, "scale")), "a mesh that is scaled to nothing", help="give factors other than 0")
        return None
    namespace.files[place] = found
    made = Mesh(str(loaded[0]), loaded[1], (factors[0], factors[1], factors[2]))
    return made if _is_sensible(namespace, place, found, made) else None


def _is_sensible(namespace: Namespace, place: Path, file: FilePath, mesh: Mesh) -> bool:
    """Whether an engine can hold so many triangles; a size that is hardly meant is a warning."""
    findings, span = namespace.values.findings, namespace.values.span(place)
    measured = measure(file.suffix.lower(), file.read_bytes())
    if measured is None:
        return True
    if measured.triangles > MOST_TRIANGLES:
        headline = f"the mesh has {measured.triangles:_} triangles, more than {MOST_TRIANGLES:_}"
        findings.add("DB005", span, headline, help="simplify it")
        return False
    size = [abs(factor) * (high - low) for factor, low, high in zip(mesh.scale, measured.lower, measured.upper, strict=True)]
    code = None if _SMALL <= max(size) <= _LARGE else "DB505" if _SMALLEST <= max(size) <= _LARGEST else "DB105"
    if code is not None:
        shown = " x ".join(f"{side:.3g}" for side in size)
        findings.add(code, span, f"the mesh is {shown} m in size", help="a mesh in millimetres needs `scale: 0.001 0.001 0.001`")
    return code != "DB105"


def picture(namespace: Namespace, path: Path, reference: str) -> tuple[str, str] | None:
    """The path and the digest of a grey picture; None after a finding."""
    found = _located(namespace, path, reference)
    if found is None:
        return None
    data = read_at_most(found, png.MAX_BYTES + 1)
    wrong = png.fault(data)
    if wrong is not None:
        help = "save it as a grey PNG of 8 or 16 bits, without interlacing"
        namespace.values.findings.add("DB103", namespace.values.span(path), wrong, help=help)
        return None
    namespace.files[path] = found
    return str(found), hashlib.sha256(data).hexdigest()


def _located(namespace: Namespace, path: Path, reference: str) -> FilePath | None:
    """The file that the scenario names, in the project or in an installed package."""
    values, document = namespace.values, namespace.document
    span = values.span(path)
    if reference.startswith("package://"):
        found = meshes.in_package(reference)
        if found is not None:
            return found
        values.findings.add("DB204", span, f"`{reference}` does not exist", help="the package must be installed, and hold such a file")
        return None
    beside = files.resolve(reference, document.directory_of(span), document.roots)
    if isinstance(beside, FilePath):
        return beside
    library = meshes.library_reference(reference)
    help = f"did you mean `{library}`?" if library else beside.help
    fix = Fix.replacing(span, reference, library, safe=False) if library else None
    values.findings.add("DB204", span, beside.headline, help=help, fix=fix)
    return None
