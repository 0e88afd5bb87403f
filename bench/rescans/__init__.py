"""What is measured of rescans."""
