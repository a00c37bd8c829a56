// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Test} from "forge-std/Test.sol";
import {IECoin} from "../src/IECoin.sol";
import {Organization} from "../src/Organization.sol";
import {ServiceManager} from "../src/ServiceManager.sol";
import {TaskManager} from "../src/TaskManager.sol";
import {Review, Terms} from "../src/interfaces/IOrganization.sol";
import {Silence, TaskRequest, Verdict} from "../src/interfaces/ITaskManager.sol";
import {FirstComeFirstServed} from "../src/policies/FirstComeFirstServed.sol";
import {TaskId} from "../src/types/TaskId.sol";

/// @notice What one attempt at a task pays, for all amounts, bonds and penalties at once: halmos has a solver look for any
/// that break an assertion (`make symbolic`). forge runs none of these.
/// @dev Not the other tests' Fixture: addresses that come from names are unknown to the solver, which would look into all
/// of them being the same.
contract SettlementSymbolic is Test {
    bytes32 private constant KIND = "waste_disposal";
    bytes32 private constant PROOF = keccak256("recording");
    uint32 private constant WINDOW = 1 hours;
    uint96 private constant FUNDS = 2000 ether;
    uint96 private constant REWARD = 1000 ether;
    uint96 private constant PRICE = 700 ether;
    address private constant ADMIN = address(0xAD);
    address private constant JUDGE = address(0x1D);
    address private constant AUDITOR = address(0xAE);
    address private constant CREATOR = address(0xC8);
    address private constant ROBOT = address(0x80);
    address private constant OWNER = address(0x08);

    IECoin private coin;
    Organization private organization;
    ServiceManager private services;
    TaskManager private tasks;
    TaskId private taskId;

    /// @dev The solver's machine numbers new contracts one after the other, whoever makes them.
    function setUp() public {
        FirstComeFirstServed policy = new FirstComeFirstServed();
        uint160 last = uint160(address(policy));
        address[] memory holders = new address[](2);
        uint256[] memory amounts = new uint256[](2);
        (holders[0], holders[1], amounts[0], amounts[1]) = (CREATOR, ROBOT, FUNDS, FUNDS);
        coin = new IECoin(holders, amounts);
        organization = Organization(address(last + 2));
        services = ServiceManager(address(last + 3));
        tasks = TaskManager(address(last + 4));
        new Organization(coin, services, tasks, policy, ADMIN, 0, Terms(0, 0, 0));
        new ServiceManager(organization, tasks);
        assert(address(new TaskManager(organization, services)) == address(tasks));
        vm.warp(1_700_000_000);
        vm.startPrank(ADMIN);
        organization.grantRole(organization.ORACLE_ROLE(), JUDGE);
        organization.grantRole(organization.AUDITOR_ROLE(), AUDITOR);
        organization.setAudit(KIND, WINDOW, Silence.Executor);
        organization.allowKind(KIND, Review.Oracle, keccak256("rules"));
        organization.grantRole(organization.OPERATOR_ROLE(), ADMIN);
        vm.stopPrank();
        for (uint256 i = 0; i < holders.length; ++i) {
            vm.prank(holders[i]);
            coin.approve(address(tasks), type(uint256).max);
        }
        vm.prank(ROBOT);
        services.setPayout(ROBOT, OWNER);
    }

    /// @dev An accepted amount is paid if and only if the agreed price covers it: to the wei, and to nobody else.
    function check_acceptedWorkIsPaidWhatTheVerdictSays(uint256 amount, uint96 bond, uint96 penalty) public {
        _proven(bond, penalty);
        bool done = _says(JUDGE, Verdict.Accepted, amount);
        assert(done == (0 < amount && amount <= PRICE));
        if (done) _assertPaid(amount, REWARD - amount, 0, bond, bond);
    }

    /// @dev Rejected work is paid nothing, and costs the penalty.
    function check_rejectedWorkIsPaidNothing(uint256 amount, uint96 bond, uint96 penalty) public {
        _proven(bond, penalty);
        bool done = _says(JUDGE, Verdict.Rejected, amount);
        assert(done == (amount == 0));
        if (done) _assertPaid(0, REWARD, penalty, bond, bond - penalty);
    }

    /// @dev What cannot be done is paid the share for its trouble.
    function check_impossibleWorkIsPaidItsShare(uint256 amount, uint96 bond, uint96 penalty) public {
        _proven(bond, penalty);
        uint256 share = PRICE / tasks.IMPOSSIBLE_SHARE();
        bool done = _says(JUDGE, Verdict.Impossible, amount);
        assert(done == (amount == 0));
        if (done) _assertPaid(share, REWARD - share, 0, bond, bond);
    }

    /// @dev What auditors say of work that the judge could not decide is paid like what judges say.
    function check_auditedWorkIsPaidWhatTheVerdictSays(uint256 amount, uint96 bond, uint96 penalty) public {
        _proven(bond, penalty);
        assert(_says(JUDGE, Verdict.Undecided, 0));
        bool done = _says(AUDITOR, Verdict.Accepted, amount);
        assert(done == (0 < amount && amount <= PRICE));
        if (done) _assertPaid(amount, REWARD - amount, 0, bond, bond);
    }

    /// @dev A task of one attempt, whose proof waits for a verdict.
    function _proven(uint96 bond, uint96 penalty) private {
        vm.assume(bond <= FUNDS && penalty <= bond);
        vm.prank(ADMIN);
        organization.setTerms(Terms(bond, penalty, 0));
        vm.prank(ROBOT);
        services.registerService(KIND, PRICE, bond, true, "");
        vm.prank(CREATOR);
        taskId = tasks.registerTask(TaskRequest(KIND, REWARD, WINDOW, WINDOW, 1, 0, 0, address(0), "{}"));
        vm.prank(ROBOT);
        tasks.submitProof(taskId, 1, PROOF, "https://store/recording.mcap");
        _assertPaid(0, 0, 0, bond, REWARD + bond);
    }

    function _says(address judge, Verdict verdict, uint256 amount) private returns (bool done) {
        bytes32 report = keccak256("report");
        bytes memory call = abi.encodeCall(
            tasks.postVerdict, (taskId, 1, PROOF, verdict, amount, report, "report", "because")
        );
        vm.prank(judge);
        (done,) = address(tasks).call(call);
    }

    /// @dev What each has got of the reward, the bond that the robot gave, and what stays in escrow.
    function _assertPaid(uint256 owner, uint256 creator, uint256 treasury, uint256 bond, uint256 held)
        private
        view
    {
        assert(coin.balanceOf(ROBOT) == FUNDS - bond);
        assert(coin.balanceOf(OWNER) == owner);
        assert(coin.balanceOf(CREATOR) == FUNDS - REWARD + creator);
        assert(coin.balanceOf(address(organization)) == treasury);
        assert(coin.balanceOf(address(tasks)) == held);
        assert(tasks.held() == held);
    }
}
