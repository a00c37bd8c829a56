// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Test} from "forge-std/Test.sol";
import {Windows} from "../src/interfaces/IOrganization.sol";
import {IECoin} from "../src/IECoin.sol";
import {Organization} from "../src/Organization.sol";
import {ServiceManager} from "../src/ServiceManager.sol";
import {TaskManager} from "../src/TaskManager.sol";
import {IProviders, Terms} from "../src/interfaces/IProviders.sol";
import {Fault, IMPOSSIBLE_SHARE, Ruling, TaskRequest} from "../src/interfaces/ITaskManager.sol";
import {Finding} from "../src/interfaces/IJudge.sol";
import {RoleJudge} from "../src/judges/RoleJudge.sol";
import {FirstComeFirstServed} from "../src/policies/FirstComeFirstServed.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {AUDITOR_ROLE, OPERATOR_ROLE, ORACLE_ROLE} from "../src/types/Roles.sol";

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
    RoleJudge private judges;
    RoleJudge private auditors;
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
        // What an organization and its services make comes between: the registry of devices, and the providers.
        services = ServiceManager(address(last + 4));
        tasks = TaskManager(address(last + 6));
        new Organization(coin, services, tasks, policy, ADMIN, 0, Terms(0, 0, 0));
        new ServiceManager(organization, tasks);
        assert(address(new TaskManager(organization, services)) == address(tasks));
        auditors = new RoleJudge(organization, keccak256("AUDITOR_ROLE"), address(0));
        judges = new RoleJudge(organization, keccak256("ORACLE_ROLE"), address(auditors));
        vm.warp(1_700_000_000);
        vm.startPrank(ADMIN);
        organization.grantRole(ORACLE_ROLE, JUDGE);
        organization.grantRole(AUDITOR_ROLE, AUDITOR);
        organization.setWindows(KIND, Windows(WINDOW, WINDOW, 3 minutes, WINDOW, WINDOW, WINDOW), 1 ether);
        organization.vouchFor(ROBOT, true);
        organization.allowKind(KIND, judges, keccak256("rules"));
        organization.grantRole(OPERATOR_ROLE, ADMIN);
        vm.stopPrank();
        for (uint256 i = 0; i < holders.length; ++i) {
            vm.prank(holders[i]);
            coin.approve(address(tasks), type(uint256).max);
        }
        IProviders providers = services.providers();
        vm.prank(ROBOT);
        providers.setPayout(ROBOT, OWNER);
    }

    /// @dev An accepted amount is paid if and only if the agreed price covers it: to the wei, and to nobody else.
    function check_acceptedWorkIsPaidWhatTheVerdictSays(uint96 amount, uint96 bond, uint96 penalty) public {
        _proven(bond, penalty);
        bool done = _says(JUDGE, Ruling.Accepted, amount);
        assert(done == (0 < amount && amount <= PRICE));
        if (done) _assertPaid(amount, REWARD - amount, 0, bond, bond);
    }

    /// @dev Rejected work is paid nothing, and costs the penalty.
    function check_rejectedWorkIsPaidNothing(uint96 amount, uint96 bond, uint96 penalty) public {
        _proven(bond, penalty);
        bool done = _says(JUDGE, Ruling.Rejected, amount);
        assert(done == (amount == 0));
        if (done) _assertPaid(0, REWARD, penalty, bond, bond - penalty);
    }

    /// @dev What cannot be done is paid the share for its trouble.
    function check_impossibleWorkIsPaidItsShare(uint96 amount, uint96 bond, uint96 penalty) public {
        _proven(bond, penalty);
        uint256 share = PRICE / IMPOSSIBLE_SHARE;
        bool done = _says(JUDGE, Ruling.Impossible, amount);
        assert(done == (amount == 0));
        if (done) _assertPaid(share, REWARD - share, 0, bond, bond);
    }

    /// @dev What auditors say of work that the judge could not decide is paid like what judges say.
    function check_auditedWorkIsPaidWhatTheVerdictSays(uint96 amount, uint96 bond, uint96 penalty) public {
        _proven(bond, penalty);
        assert(_says(JUDGE, Ruling.None, 0));
        bool done = _says(AUDITOR, Ruling.Accepted, amount);
        assert(done == (0 < amount && amount <= PRICE));
        if (done) _assertPaid(amount, REWARD - amount, 0, bond, bond);
    }

    /// @dev What stands first and is concluded later pays the same, and the penalty only where it is rejected.
    function check_whatStandsIsPaidWhenItIsConcluded(uint8 said, uint96 amount, uint96 bond, uint96 penalty)
        public
    {
        _proven(bond, penalty);
        Ruling ruling = said % 2 == 0 ? Ruling.Accepted : Ruling.Rejected;
        bytes memory call = abi.encodeCall(
            tasks.rule, (taskId, 1, PROOF, ruling, Fault.Nobody, amount, uint40(block.timestamp + WINDOW), 0)
        );
        vm.prank(address(judges));
        (bool done,) = address(tasks).call(call);
        uint256 max = ruling == Ruling.Accepted ? PRICE : 0;
        assert(done == (amount <= max && (amount != 0 || max == 0)));
        if (!done) return;
        _assertPaid(0, 0, 0, bond, REWARD + bond);
        vm.warp(block.timestamp + WINDOW + 1);
        tasks.conclude(taskId);
        if (max != 0) _assertPaid(amount, REWARD - amount, 0, bond, bond);
        else _assertPaid(0, REWARD, penalty, bond, bond - penalty);
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

    function _says(address judge, Ruling ruling, uint96 amount) private returns (bool done) {
        Finding memory f =
            Finding(taskId, 1, PROOF, keccak256("report"), 0, ruling, Fault.Nobody, amount, "because");
        bytes memory call = judge == AUDITOR
            ? abi.encodeCall(auditors.ruleFor, (judges, f, "report"))
            : abi.encodeCall(judges.rule, (f, "report"));
        vm.prank(judge);
        (done,) = judge == AUDITOR ? address(auditors).call(call) : address(judges).call(call);
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
