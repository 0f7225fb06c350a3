from inpaint3d.contracts.suite import stage_contract

TestContract = stage_contract(__file__)
