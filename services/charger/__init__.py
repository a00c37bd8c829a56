"""The dock's side of a charge: delivers a metered session and proves it for the organization."""
