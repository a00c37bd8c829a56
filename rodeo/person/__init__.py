"""People who do tasks and judge them: statements with photos, what is known of those, deadlines.

The accounts of people are in `rodeo.access`, people in the lab in `services.robot_sim`.
"""
