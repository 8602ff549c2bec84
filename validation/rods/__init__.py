"""Report on slender rods: experiments of cosseratbench, and penalty against event."""
