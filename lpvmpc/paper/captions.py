"""What the reproduction's pictures show."""

CAPTIONS = {
    "fig4-learning-curve": "Fig. 4. Loss of the paper's network, trained as in the paper on our "
    "data, with whole runs held out.",
    "fig5-stiffness": "Fig. 5. Secant stiffness of both axles over a driven lap that is in no "
    "data: the car's, and what both networks predict from that lap's measurements.",
    "fig6-sphere": "Fig. 6. The genetic algorithm on the sphere function, as printed and ours: "
    "median and quartiles.",
    "fig7-speed-wind": "Fig. 7. Wind, speed, and the error of the speed.",
    "fig8-path": "Fig. 8. Path, and the lateral error where that of the baseline is largest, where "
    "the bend is tightest and where the wind is strongest.",
    "fig9-commands": "Fig. 9. Steering, acceleration, lateral velocity.",
    "fig10-errors": "Fig. 10. Tracking errors; on the right with what the paper prints of its own "
    "controller, whose largest speed error is below its RMSE.",
    "fig11-computation-time": "Fig. 11. Computation time of our controller.",
    "ablation": "Lateral RMSE from the printed formulas (top) to the full controller (bottom), one "
    "change at a time.",
    "tuning": "Best cost over the evaluations: the genetic algorithm, and a particle swarm for the "
    "speed controller where there is one.",
}
"""What each picture shows."""
