"""Lessons that mark themselves, and the marks of a class.

lessons.py          a lesson as a folder: steps, checks, hints; the lessons that come with deepbots
hand_ins.py         a folder, a zip or a file that a student hands in, as the parts that a lesson asks for
marking.py          the marks of one step: the teacher's task with the student's parts
evidence.py         whether the record of a training explains its policy
copies.py           policies that two students handed in
marking_process.py  the entry point of the process, with limits, that marks a step
grading.py          the marks of many hand-ins, and their tables; a lesson that a student has started
proof.py            the proof of a lesson: starters, solutions, half solutions, and cheats
"""
