"""`python -m uav_recon`: the same command line as `uav-recon`."""

from uav_recon.cli.main import main

if __name__ == "__main__":
    main()
