"""The error of a function of Webots that is not implemented, and the names of these functions.

The names are facts of the reference manual of Webots. A name that is not here and not implemented does not
exist in Webots either.
"""

from __future__ import annotations

from collections.abc import Mapping

from deepbots_cli.diagnostics.nearest import nearest_word


class NotImplementedCallError(NotImplementedError, AttributeError):
    """A controller uses a part of Webots' interface that deepbots does not have."""


MISSING: Mapping[str, str] = {
    "Robot": "batterySensorDisable batterySensorEnable batterySensorGetSamplingPeriod batterySensorGetValue"
    " getJoystick getMouse getUrdf stepBegin stepEnd waitForUserInputEvent wwiReceiveText wwiSendText"
    " setMode",
    "Supervisor": "animationStartRecording animationStopRecording exportImage getSelected movieFailed"
    " movieIsReady movieStartRecording movieStopRecording simulationRevert"
    " virtualRealityHeadsetGetOrientation virtualRealityHeadsetGetPosition virtualRealityHeadsetIsUsed"
    " worldLoad worldReload worldSave",
    "Node": "exportString getNumberOfFields getFieldByIndex getNumberOfBaseNodeFields getBaseNodeFieldByIndex"
    " getProtoFieldByIndex getProtoNumberOfFields getProto getStaticBalance"
    " moveViewpoint remove setVisibility enableContactPointsTracking disableContactPointsTracking"
    " enablePoseTracking disablePoseTracking getFromProtoDef",
    "Field": "disableSFTracking enableSFTracking importMFNode importMFNodeFromString importSFNode"
    " importSFNodeFromString removeMF removeSF insertMFBool insertMFColor insertMFFloat insertMFInt32"
    " insertMFRotation insertMFString insertMFVec2f insertMFVec3f",
    "GPS": "convertToDegreesMinutesSeconds",
    "TouchSensor": "getLookupTable",
    "Camera": "getExposure getFocalDistance getFocalLength getMaxFocalDistance getMinFocalDistance"
    " setExposure setFocalDistance recognitionDisable recognitionEnable getRecognitionNumberOfObjects"
    " getRecognitionObjects getRecognitionSamplingPeriod getRecognitionSegmentationImage"
    " getRecognitionSegmentationImageArray hasRecognitionSegmentation isRecognitionSegmentationEnabled"
    " disableRecognitionSegmentation enableRecognitionSegmentation saveRecognitionSegmentationImage",
    "Display": "attachCamera detachCamera imageCopy imageDelete imageLoad imageNew imagePaste imageSave",
    "Speaker": "getEngine getLanguage",
    "Connector": "disablePresence enablePresence getPresence getPresenceSamplingPeriod isLocked lock unlock",
    "Pen": "setInkColor write",
    "Microphone": "enable getSampleData getSampleSize",
    "VacuumGripper": "turnOn turnOff isOn enablePresence disablePresence getPresence",
    "Skin": "getBoneCount getBoneName getBoneOrientation getBonePosition setBoneOrientation setBonePosition",
    "Radio": "enable send setAddress setChannel setFrequency setTxPower",
}
"""The functions of each class that deepbots does not have."""


MISSING_CLASSES = ("AnsiCodes", "CameraRecognitionObject", "Joystick", "Motion", "Mouse", "ImageRef")
"""The names of the module `controller` of Webots that deepbots does not have."""


def missing_attribute(owner: type, name: str) -> AttributeError:
    """Return the error for an attribute that an object of the module `controller` does not have."""
    for base in owner.__mro__:
        if name in MISSING.get(base.__name__, "").split():
            return NotImplementedCallError(f"{base.__name__}.{name} is not implemented")
    public = [word for base in owner.__mro__ for word in vars(base) if not word.startswith("_")]
    near = nearest_word(name, public)
    hint = f"; did you mean '{near}'?" if near else ""
    return AttributeError(f"'{owner.__name__}' has no attribute '{name}'{hint}")
