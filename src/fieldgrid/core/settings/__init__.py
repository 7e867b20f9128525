"""Settings of a build: defaults, over them a TOML file, over that the flags."""
