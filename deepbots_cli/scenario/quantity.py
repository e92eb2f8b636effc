"""Quantities and texts under the names that the models use.

Plain aliases are fixed numbers; those that begin with `Drawn` may be drawn anew in every episode.
"""

from __future__ import annotations

from typing import Annotated

from deepbots_cli.scenario.fields import Expression, FilePath, Pattern, Quantity, Reference, Scalar
from deepbots_cli.scenario.names import Name
from deepbots_cli.scenario.plain import Colour, Count, Switch, Text

Length = Annotated[Scalar, Quantity("length", minimum=0)]
Thickness = Annotated[Scalar, Quantity("length", minimum=1e-4)]
Duration = Annotated[Scalar, Quantity("time", minimum=0)]
Period = Annotated[Scalar, Quantity("time", minimum=0, exclusive=True)]
Tick = Annotated[Scalar, Quantity("time", minimum=0, exclusive=True, usual="ms")]
Factor = Annotated[Scalar, Quantity("number", minimum=0)]
Share = Annotated[Scalar, Quantity("number", minimum=0, maximum=1)]
Extent = Annotated[Scalar, Quantity("length", components=3, minimum=1e-4)]
Area = Annotated[Scalar, Quantity("length", components=2, minimum=1e-4)]
Point = Annotated[Scalar, Quantity("length", components=2)]

DrawnFactor = Annotated[Scalar, Quantity("number", stage="episode", minimum=0)]
DrawnShare = Annotated[Scalar, Quantity("number", stage="episode", minimum=0, maximum=1)]
DrawnMass = Annotated[Scalar, Quantity("mass", stage="episode", minimum=0, exclusive=True)]
DrawnDuration = Annotated[Scalar, Quantity("time", stage="episode", minimum=0)]
DrawnDelay = Annotated[Scalar, Quantity("time", stage="episode", minimum=0, maximum=60, usual="ms")]
DrawnCoordinate = Annotated[Scalar, Quantity("length", stage="episode")]
DrawnAngle = Annotated[Scalar, Quantity("angle", stage="episode", words=("any",))]
DrawnCount = Annotated[Scalar, Quantity("number", stage="episode", minimum=0, whole=True)]

Whole = Annotated[int, Count()]
OnOff = Annotated[bool, Switch()]
Prose = Annotated[str, Text()]
Paint = Annotated[str, Colour()]

SharedName = Annotated[str, Name(shared=True)]
LocalName = Annotated[str, Name()]
LinkPattern = Annotated[str, Pattern("link")]
JointPattern = Annotated[str, Pattern("joint")]
BodyName = Annotated[str, Reference("body")]
JointNames = Annotated[str | tuple[str, ...], Reference("joints")]
LinkNames = Annotated[str | tuple[str, ...], Reference("links")]
LinkName = Annotated[str, Reference("link")]
JointName = Annotated[str, Reference("joint")]
MeshFile = Annotated[str, FilePath("mesh file")]

Signal = Annotated[Scalar, Expression("signal")]
