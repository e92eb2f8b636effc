"""What a training came to, for people who read it and for programs that use it.

report.py   one HTML file about a run or a group: result, curves, episodes, scenario
figures.py  the figures of a report
export.py   the policy of a run as ONNX graphs
card.py     the bundle of an exported policy: its card, and whether it fits a scenario
"""
