from inpaint3d.contracts.kit.suite import stage_contract

TestContract = stage_contract(__file__)
