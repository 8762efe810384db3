"""The page's server: who may look, who may command, and nothing else."""
