"""Cameras and range finders, as the module `controller` has them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepbots_cli.errors import EngineError
from deepbots_cli.webots.device import Sensor
from deepbots_cli.webots.nodes import boolean, child, integer, number, text
from deepbots_cli.webots.unimplemented import NotImplementedCallError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from deepbots_cli.webots.rendering import Pictures
    from deepbots_cli.webots.scene import Device as Spec
    from deepbots_cli.webots.simulation import Simulation


class _Optics(Sensor):
    """A device with a picture, planar and with square pixels."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._size = max(1, integer(spec.node, "width")), max(1, integer(spec.node, "height"))
        self._fov = number(spec.node, "fieldOfView")

    def _begin(self) -> None:
        """Check that pictures can be drawn, so that an error is raised where the device is enabled."""
        from deepbots_cli.webots.rendering import require_opengl

        node = self._spec.node
        is_planar = text(node, "projection") == "planar" and not boolean(node, "spherical")
        if not (is_planar and 0 < self._fov < math.pi):
            raise NotImplementedCallError(
                f"a {self._spec.type} with a projection that is not planar is not implemented"
            )
        self._require_size()
        try:
            require_opengl()
        except EngineError as error:
            raise EngineError(f"{self._spec.type} '{self._spec.name}' cannot draw: {error}") from error

    def _require_size(self) -> None:
        from deepbots_cli.webots.rendering import MAX_PIXELS

        if max(self._size) > MAX_PIXELS:
            raise ValueError(f"{self._spec.type} '{self._spec.name}' is larger than {MAX_PIXELS} pixels")

    def _pictures(self) -> Pictures:
        return self._simulation.pictures

    def getFov(self) -> float:
        return self._fov

    def getWidth(self) -> int:
        return self._size[0]

    def getHeight(self) -> int:
        return self._size[1]

    def _save(self, picture: Any, filename: str, quality: int) -> int:
        """Write a picture by the suffix of the file; returns 0, or -1 if that fails."""
        from PIL import Image

        kinds = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}
        kind = kinds.get(Path(filename).suffix.lower())
        if kind is None:
            self._warn(f"saveImage() writes .png and .jpg, and not '{filename}'")
            return -1
        options = {"quality": min(max(int(quality), 1), 100)} if kind == "JPEG" else {}
        try:
            Image.fromarray(picture).save(filename, format=kind, **options)
        except OSError as error:
            self._warn(f"saveImage(): {error}")
            return -1
        return 0


class Camera(_Optics):
    """A camera; its picture is BGRA, row by row from above."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._picture: NDArray[np.uint8] | None = None
        self._zoom = child(spec.node, "zoom")

    def sample(self) -> None:
        import numpy as np

        colors = self._pictures().colors(self._frame(), self._size, self._fov, self.getNear())
        noise = number(self._spec.node, "noise") * 255  # Webots states it as a share of a channel's range
        if noise > 0:
            # numpy draws a picture at once; its seed comes from the world, so that runs repeat.
            generator = np.random.default_rng(self._simulation.random.getrandbits(64))
            noisy = colors + generator.normal(0.0, noise, colors.shape)
            colors = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        self._picture = colors

    def getNear(self) -> float:
        return max(number(self._spec.node, "near"), 1e-3)

    def getImage(self) -> bytes | None:
        """Return the picture; None before the first one."""
        import numpy as np

        if self._picture is None:
            return None
        opaque = np.full((*self._picture.shape[:2], 1), 255, np.uint8)
        return np.concatenate((self._picture[..., ::-1], opaque), axis=-1).tobytes()

    def getImageArray(self) -> list[list[list[int]]] | None:
        """Return red, green and blue of the pixel x, y at `[x][y]`; None before the first picture."""
        return None if self._picture is None else self._picture.swapaxes(0, 1).tolist()

    @staticmethod
    def imageGetRed(image: bytes, width: int, x: int, y: int) -> int:
        return image[4 * (y * width + x) + 2]

    @staticmethod
    def imageGetGreen(image: bytes, width: int, x: int, y: int) -> int:
        return image[4 * (y * width + x) + 1]

    @staticmethod
    def imageGetBlue(image: bytes, width: int, x: int, y: int) -> int:
        return image[4 * (y * width + x)]

    @staticmethod
    def imageGetGray(image: bytes, width: int, x: int, y: int) -> float:
        at = 4 * (y * width + x)
        return (image[at] + image[at + 1] + image[at + 2]) / 3

    imageGetGrey = imageGetGray

    def saveImage(self, filename: str, quality: int) -> int:
        return -1 if self._picture is None else self._save(self._picture, filename, quality)

    def hasRecognition(self) -> bool:
        return child(self._spec.node, "recognition") is not None

    def getMinFov(self) -> float:
        return self._fov if self._zoom is None else number(self._zoom, "minFieldOfView")

    def getMaxFov(self) -> float:
        return self._fov if self._zoom is None else number(self._zoom, "maxFieldOfView")

    def setFov(self, f: float) -> None:
        """Set the field of view (rad) of a camera with a Zoom node."""
        low, high = self.getMinFov(), self.getMaxFov()
        if self._zoom is None or not low <= f <= high:
            self._warn(f"setFov({f:g}) has no effect: the camera has no Zoom node that allows it")
            return
        self._fov = float(f)


class RangeFinder(_Optics):
    """A depth camera: distances along its axis (m), row by row from above; infinite beyond its range."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._depths: NDArray[np.float32] | None = None

    def sample(self) -> None:
        import numpy as np

        node = self._spec.node
        depths = self._pictures().depths(self._frame(), self._size, self._fov).astype(np.float32)
        least, most = self.getMinRange(), self.getMaxRange()
        # Before the noise, which would move depths across the limits.
        is_seen = (depths >= least) & (depths <= most)
        noise, resolution = number(node, "noise") * most, number(node, "resolution")
        if noise > 0:
            generator = np.random.default_rng(self._simulation.random.getrandbits(64))
            depths += generator.normal(0.0, noise, depths.shape).astype(np.float32)
        if resolution > 0:
            depths = np.round(depths / resolution) * np.float32(resolution)
        depths[~is_seen] = np.inf
        self._depths = depths

    def getMinRange(self) -> float:
        return number(self._spec.node, "minRange")

    def getMaxRange(self) -> float:
        return number(self._spec.node, "maxRange")

    def getRangeImage(self, data_type: str = "list") -> Any:
        """Return the distances as a list, or as bytes of float32 for `buffer`; None before the first."""
        if self._depths is None:
            return None
        return self._depths.tobytes() if data_type == "buffer" else self._depths.ravel().tolist()

    def getRangeImageArray(self) -> list[list[float]] | None:
        """Return the distances, a list for each row."""
        return None if self._depths is None else self._depths.tolist()

    @staticmethod
    def rangeImageGetDepth(image: Any, width: int, x: int, y: int) -> float:
        return float(image[y * width + x])

    def saveImage(self, filename: str, quality: int) -> int:
        """Write a gray picture: white at the largest range."""
        import numpy as np

        if self._depths is None:
            return -1
        gray = np.clip(self._depths / self.getMaxRange(), 0.0, 1.0) * 255
        return self._save(gray.astype(np.uint8), filename, quality)
