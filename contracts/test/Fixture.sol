// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {Test} from "forge-std/Test.sol";
import {Windows} from "../src/interfaces/IOrganization.sol";
import {IECoin} from "../src/IECoin.sol";
import {Organization} from "../src/Organization.sol";
import {ServiceManager} from "../src/ServiceManager.sol";
import {TaskManager} from "../src/TaskManager.sol";
import {Finding, IJudge} from "../src/interfaces/IJudge.sol";
import {IProviders, Terms} from "../src/interfaces/IProviders.sol";
import {ServiceState} from "../src/interfaces/IServiceManager.sol";
import {Fault, Ruling, Task, TaskRequest, TaskState} from "../src/interfaces/ITaskManager.sol";
import {CommitteeJudge} from "../src/judges/CommitteeJudge.sol";
import {RoleJudge} from "../src/judges/RoleJudge.sol";
import {FirstComeFirstServed} from "../src/policies/FirstComeFirstServed.sol";
import {Units} from "../src/libraries/Units.sol";
import {KindId} from "../src/types/KindId.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {AUDITOR_ROLE, OPERATOR_ROLE, ORACLE_ROLE, TREASURER_ROLE} from "../src/types/Roles.sol";
import {Deployed} from "./Deployed.sol";

/// @notice Short words for numbers of tasks and services.
abstract contract Numbers {
    function taskNo(uint256 number) internal pure returns (TaskId) {
        return TaskId.wrap(number);
    }

    function serviceNo(uint256 number) internal pure returns (ServiceId) {
        return ServiceId.wrap(number);
    }

    function following(TaskId taskId) internal pure returns (TaskId) {
        return taskNo(TaskId.unwrap(taskId) + 1);
    }

    function following(ServiceId serviceId) internal pure returns (ServiceId) {
        return serviceNo(ServiceId.unwrap(serviceId) + 1);
    }
}

/// @notice An organization with its contracts, two humans who post tasks and three robots who do them. The organization
/// vouches for all five.
abstract contract Fixture is Deployed, Numbers, Test {
    bytes32 internal constant CLEANING = "waste_disposal";
    bytes32 internal constant CHARGING = "battery_charging";
    bytes32 internal constant RULES = keccak256("rules");
    bytes32 internal constant PROOF = keccak256("recording");
    bytes32 internal constant REPORT = keccak256("report");
    string internal constant URI = "https://store/recording.mcap";
    uint32 internal constant WINDOW = 1 hours;
    uint32 internal constant SHORTEST = 30 minutes;
    uint32 internal constant GRACE = 15 minutes;
    uint32 internal constant AUDIT_WINDOW = 2 hours;
    uint8 internal constant ATTEMPTS = 3;
    /// @dev The bond that a provider agrees to who takes any.
    uint256 internal constant NO_LIMIT = type(uint256).max;

    address internal immutable admin = makeAddr("admin");
    address internal immutable oracle = makeAddr("oracle");
    address internal immutable auditor = makeAddr("auditor");
    address internal immutable alice = makeAddr("alice");
    address internal immutable bob = makeAddr("bob");
    address internal immutable robot1 = makeAddr("robot1");
    address internal immutable robot2 = makeAddr("robot2");
    address internal immutable robot3 = makeAddr("robot3");
    address internal immutable stranger = makeAddr("stranger");

    IECoin internal coin;
    FirstComeFirstServed internal policy;
    Organization internal organization;
    ServiceManager internal services;
    IProviders internal providers;
    TaskManager internal tasks;
    RoleJudge internal oracleJudge;
    RoleJudge internal auditorJudge;

    function setUp() public virtual {
        address[] memory holders = new address[](4);
        uint256[] memory amounts = new uint256[](4);
        // The organization comes after the coin.
        address organization_ = vm.computeCreateAddress(address(this), vm.getNonce(address(this)) + 2);
        (holders[0], holders[1], holders[2], holders[3]) = (organization_, alice, bob, robot1);
        for (uint256 i = 0; i < 4; ++i) {
            amounts[i] = 2000 ether;
        }
        coin = IECoin(deployed("IECoin", abi.encode(holders, amounts)));
        policy = FirstComeFirstServed(deployed("FirstComeFirstServed"));
        found(coin);
        for (uint256 i = 1; i < 4; ++i) {
            vm.prank(holders[i]);
            coin.approve(address(tasks), type(uint256).max);
        }
        vm.warp(1_700_000_000);
    }

    /// @dev An organization that pays in `token`: all variables but `coin` and `policy`.
    function found(IERC20 token) internal {
        uint64 nonce = vm.getNonce(address(this));
        organization = Organization(vm.computeCreateAddress(address(this), nonce));
        services = ServiceManager(vm.computeCreateAddress(address(this), nonce + 1));
        tasks = TaskManager(vm.computeCreateAddress(address(this), nonce + 2));
        organizationOf(token, tasks);
        deployed("ServiceManager", abi.encode(organization, tasks));
        deployed("TaskManager", abi.encode(organization, services));
        providers = services.providers();
        auditorJudge = roleJudge(AUDITOR_ROLE, address(0));
        oracleJudge = roleJudge(ORACLE_ROLE, address(auditorJudge));

        (uint256 unit,) = Units.unitOf(token);
        uint96 dearest = uint96(Units.max(unit));
        vm.startPrank(admin);
        organization.grantRole(ORACLE_ROLE, oracle);
        organization.grantRole(AUDITOR_ROLE, auditor);
        organization.grantRole(OPERATOR_ROLE, admin);
        organization.grantRole(TREASURER_ROLE, admin);
        organization.setWindows(CLEANING, windows(SHORTEST, uint16(GRACE)), dearest);
        organization.setWindows(CHARGING, windows(SHORTEST, uint16(GRACE)), dearest);
        // For tests that allow another kind.
        organization.setWindows("painting", windows(SHORTEST, uint16(GRACE)), dearest);
        address[5] memory known = [alice, bob, robot1, robot2, robot3];
        for (uint256 i = 0; i < known.length; ++i) {
            organization.vouchFor(known[i], true);
        }
        organization.setAuditors(auditorJudge);
        organization.allowKind(CLEANING, oracleJudge, RULES);
        organization.allowKind(CHARGING, oracleJudge, RULES);
        vm.stopPrank();
    }

    /// @dev Of a kind whose tasks have at least `min` seconds.
    function windows(uint32 min, uint16 grace) internal pure returns (Windows memory) {
        return Windows(min, 30 days, grace, 15 minutes, 7 days, AUDIT_WINDOW);
    }

    /// @dev It takes `services` and the `tasks` given for its own.
    function organizationOf(IERC20 token, TaskManager tasks_) internal returns (Organization) {
        Terms memory none = Terms(0, 0, 0);
        bytes memory arguments = abi.encode(token, services, tasks_, policy, admin, 0, none);
        return Organization(deployed("Organization", arguments));
    }

    function roleJudge(bytes32 role, address next) internal returns (RoleJudge) {
        return RoleJudge(deployed("RoleJudge", abi.encode(organization, role, next)));
    }

    function committeeJudge(address next) internal returns (CommitteeJudge) {
        return CommitteeJudge(deployed("CommitteeJudge", abi.encode(organization, next)));
    }

    function setTerms(uint96 bond, uint96 penalty, uint8 maxFailures) internal {
        vm.prank(admin);
        organization.setTerms(Terms(bond, penalty, maxFailures));
    }

    function update(ServiceId serviceId, uint256 price, ServiceState next) internal {
        vm.prank(services.providerOf(serviceId));
        services.updateService(serviceId, price, next);
    }

    /// @dev Its executor gives it back.
    function giveBack(TaskId taskId) internal {
        Task memory t = tasks.task(taskId);
        vm.prank(services.providerOf(t.serviceId));
        tasks.abandonTask(taskId, t.attempt);
    }

    /// @dev One attempt at the task from proof to verdict.
    function attempt(TaskId taskId, bool accepted) internal {
        submit(taskId);
        judge(taskId, accepted);
    }

    function request(uint256 reward) internal pure returns (TaskRequest memory) {
        return TaskRequest(CLEANING, reward, WINDOW, WINDOW, ATTEMPTS, 0, 0, address(0), "{}");
    }

    /// @dev The highest price of a level, see Units.
    function priceOf(uint64 level, uint256 unit) internal pure returns (uint256) {
        uint256 exponent = level < 1000 ? 0 : (level - 100) / 900;
        return (level - exponent * 900) * 10 ** exponent * unit;
    }

    function post(address creator, uint256 reward) internal returns (TaskId taskId) {
        vm.prank(creator);
        return tasks.registerTask(request(reward));
    }

    function offer(address provider, uint256 price) internal returns (ServiceId serviceId) {
        vm.prank(provider);
        return services.registerService(CLEANING, price, NO_LIMIT, true, "");
    }

    function submit(TaskId taskId) internal {
        Task memory t = tasks.task(taskId);
        vm.prank(services.service(t.serviceId).provider);
        tasks.submitProof(taskId, t.attempt, PROOF, URI);
    }

    /// @dev The oracle accepts at the full price, or rejects.
    function judge(TaskId taskId, bool accepted) internal {
        uint256 price = tasks.task(taskId).price;
        judgeAs(oracle, taskId, accepted ? Ruling.Accepted : Ruling.Rejected, accepted ? price : 0);
    }

    /// @dev The auditor rules on what the oracle has passed on, by the ruling None.
    function judgeAs(address who, TaskId taskId, Ruling ruling, uint256 amount) internal {
        Finding memory f = finding(taskId, ruling, amount);
        vm.prank(who);
        if (who == auditor) auditorJudge.ruleFor(oracleJudge, f, "report");
        else oracleJudge.rule(f, "report");
    }

    function finding(TaskId taskId, Ruling ruling, uint256 amount) internal view returns (Finding memory) {
        Task memory t = tasks.task(taskId);
        return Finding(
            taskId, t.attempt, t.proofHash, REPORT, RULES, ruling, Fault.Nobody, uint96(amount), "because"
        );
    }

    /// @dev What the kind's judge says until `until`, whichever contract it is.
    function ruleUntil(IJudge judge_, TaskId taskId, Ruling ruling, uint256 amount, uint256 until) internal {
        Finding memory f = finding(taskId, ruling, amount);
        vm.prank(address(judge_));
        tasks.rule(taskId, f.attempt, f.proofHash, ruling, f.fault, f.amount, uint40(until), f.reportHash);
    }

    function state(TaskId taskId) internal view returns (TaskState) {
        return tasks.task(taskId).state;
    }

    function assertState(TaskId taskId, TaskState expected) internal view {
        assertEq(uint8(state(taskId)), uint8(expected), "task state");
    }

    function assertAssigned(TaskId taskId, ServiceId serviceId) internal view {
        assertState(taskId, TaskState.Assigned);
        assertEq(tasks.task(taskId).serviceId, serviceId, "the task's service");
        assertEq(services.service(serviceId).taskId, taskId, "the service's task");
    }

    /// @dev Its number with the judge that it has now.
    function cleaning() internal view returns (KindId) {
        return organization.numberOf(CLEANING);
    }

    function exists(TaskId taskId) internal view returns (bool) {
        return TaskId.unwrap(taskId) <= tasks.taskCount();
    }

    function exists(ServiceId serviceId) internal view returns (bool) {
        return ServiceId.unwrap(serviceId) <= services.serviceCount();
    }

    function assertEq(TaskId actual, TaskId expected) internal pure {
        assertEq(TaskId.unwrap(actual), TaskId.unwrap(expected));
    }

    function assertEq(TaskId actual, TaskId expected, string memory what) internal pure {
        assertEq(TaskId.unwrap(actual), TaskId.unwrap(expected), what);
    }

    function assertEq(TaskId actual, uint256 number) internal pure {
        assertEq(TaskId.unwrap(actual), number);
    }

    function assertEq(TaskId actual, uint256 number, string memory what) internal pure {
        assertEq(TaskId.unwrap(actual), number, what);
    }

    function assertEq(ServiceId actual, ServiceId expected) internal pure {
        assertEq(ServiceId.unwrap(actual), ServiceId.unwrap(expected));
    }

    function assertEq(ServiceId actual, ServiceId expected, string memory what) internal pure {
        assertEq(ServiceId.unwrap(actual), ServiceId.unwrap(expected), what);
    }

    function assertEq(ServiceId actual, uint256 number) internal pure {
        assertEq(ServiceId.unwrap(actual), number);
    }

    function assertEq(ServiceId actual, uint256 number, string memory what) internal pure {
        assertEq(ServiceId.unwrap(actual), number, what);
    }

    function assertEq(KindId actual, uint256 number) internal pure {
        assertEq(KindId.unwrap(actual), number);
    }

    function assertEq(KindId actual, uint256 number, string memory what) internal pure {
        assertEq(KindId.unwrap(actual), number, what);
    }
}
