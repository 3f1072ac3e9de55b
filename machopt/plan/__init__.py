"""One file a step, each owning its result type: path → candidates → score → choose → smooth → check → retime."""
