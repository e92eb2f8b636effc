"""Webots' module `vehicle`, which deepbots does not have."""

raise ImportError("the module 'vehicle' of Webots, with Driver and Car, is not implemented")
