"""What work on a robot is made of: body, arm, floor, wrist camera, memory and recording.

It knows no kind of work (`rodeo_kinds`); the mind that chooses tasks is `services.robot_agent`.
"""
