"""What runs, in which order, on which workers: flows and the command line. The only room that imports Prefect."""
