"""The ground station: mission files, the MAVSDK link, metrics, figures and the command line."""
