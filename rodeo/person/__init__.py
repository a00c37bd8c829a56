"""People who do tasks and judge them: statements with photos, what is known of those, deadlines."""
