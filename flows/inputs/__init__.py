"""What enters the lake besides scans: annotations, trajectories, finished datasets; and the demo's scans."""
