"""The seven built-in towns as compressed OpenDRIVE files, and the kit that authors them.

`python -m me3bev_plugins.simulator.highway.towns.author [T3 ...]` writes the files anew from the layouts
`t1.py` ... `t7.py`. Reading them is `me3bev_plugins.simulator.highway.maps.load_town`.
"""
