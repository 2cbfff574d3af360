"""What is shown or written: clips and frames."""
