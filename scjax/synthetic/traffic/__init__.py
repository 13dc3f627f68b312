"""Traffic simulation: vehicles that follow each other, change lanes and yield."""

from scjax.synthetic.traffic.fleet import Fleet, draw_fleet, draw_laterals, make_fleet
from scjax.synthetic.traffic.simulation import TIME_STEP, Obstacle, TrafficSimulation

__all__ = ["TIME_STEP", "Fleet", "Obstacle", "TrafficSimulation", "draw_fleet", "draw_laterals", "make_fleet"]
