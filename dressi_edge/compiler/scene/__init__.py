"""What a user builds: problems and jobs in, programs out; results of a run."""
