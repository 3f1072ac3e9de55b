steerPlan(DATA);
