"""Teachers, which the policy imitates before or while it learns from rewards.

teacher.py         a script, a recording or a policy as teacher: when the policy imitates it, and how much
policy_teacher.py  a policy of another run as teacher
"""
