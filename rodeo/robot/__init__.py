"""What work on a robot is made of: body, arm, floor, wrist camera, memory and recording. It knows no kind."""
