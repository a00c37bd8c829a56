// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Service, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {
    Fault,
    ITaskManager,
    Ruling,
    Standing,
    Task,
    TaskRequest,
    TaskState
} from "../src/interfaces/ITaskManager.sol";
import {Finding, IJudge} from "../src/interfaces/IJudge.sol";
import {IOrganization, Windows} from "../src/interfaces/IOrganization.sol";
import {IProviders} from "../src/interfaces/IProviders.sol";
import {IServiceManager} from "../src/interfaces/IServiceManager.sol";
import {RoleJudge} from "../src/judges/RoleJudge.sol";
import {KindId} from "../src/types/KindId.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {AUDITOR_ROLE, GUARDIAN_ROLE, ORACLE_ROLE} from "../src/types/Roles.sol";
import {Fixture} from "./Fixture.sol";

/// @notice What a ruling does: each of the five, final at once, standing, replaced, concluded.
contract RulingsTest is Fixture {
    uint96 private constant BOND = 20 ether;
    uint96 private constant PENALTY = 5 ether;
    uint256 private constant PRICE = 80 ether;
    uint256 private constant REWARD = 100 ether;
    TaskId private _task;
    ServiceId private _service;

    function setUp() public override {
        super.setUp();
        setTerms(BOND, PENALTY, 0);
        _service = offer(robot1, PRICE);
        _task = post(alice, REWARD);
        submit(_task);
    }

    // -- each ruling, final at once, and standing first ---------------------------------------------------

    function test_acceptedPaysTheAmountAndRefundsTheRest() public {
        for (uint256 i = 0; i < 2; ++i) {
            (uint256 paid, uint256 refunded) = _end(Ruling.Accepted, 60 ether, i == 1);
            assertEq(paid, 60 ether);
            assertEq(refunded, 40 ether);
            assertState(_task, TaskState.Settled);
            Service memory s = services.service(_service);
            assertEq(s.completed, i + 1);
            assertEq(s.bond, BOND);
            _again();
        }
    }

    function test_rejectedCostsThePenaltyAndTheTaskQueuesAgain() public {
        for (uint256 i = 0; i < 2; ++i) {
            uint256 treasury = coin.balanceOf(address(organization));
            (uint256 paid,) = _end(Ruling.Rejected, 0, i == 1);
            assertEq(paid, 0);
            assertEq(coin.balanceOf(address(organization)) - treasury, PENALTY);
            Service memory s = services.service(_service);
            assertEq(s.rejected, i + 1);
            assertEq(s.bond, BOND - PENALTY * (i + 1));
            assertEq(s.failures, i + 1);
            _again();
        }
    }

    function test_givenUpCostsNothingAndTheTaskQueuesAgain() public {
        for (uint256 i = 0; i < 2; ++i) {
            (uint256 paid, uint256 refunded) = _end(Ruling.GivenUp, 0, i == 1);
            assertEq(paid + refunded, 0);
            assertState(_task, TaskState.Open);
            _assertNoRecord();
            _again();
        }
    }

    function test_impossiblePaysATenthAndEndsTheTask() public {
        for (uint256 i = 0; i < 2; ++i) {
            (uint256 paid, uint256 refunded) = _end(Ruling.Impossible, 0, i == 1);
            assertEq(paid, PRICE / 10);
            assertEq(refunded, REWARD - PRICE / 10);
            assertState(_task, TaskState.Settled);
            _assertNoRecord();
            _again();
        }
    }

    function test_voidRefundsAllAndEndsTheTask() public {
        for (uint256 i = 0; i < 2; ++i) {
            (uint256 paid, uint256 refunded) = _end(Ruling.Void, 0, i == 1);
            assertEq(paid, 0);
            assertEq(refunded, REWARD);
            assertState(_task, TaskState.Failed);
            _assertNoRecord();
            _again();
        }
    }

    // -- what stands ---------------------------------------------------------------------------------------

    function test_whileARulingStandsTheServiceIsFreeButForItsPenalty() public {
        uint256 caseEnd = tasks.task(_task).caseEnd;
        vm.expectEmit();
        emit ITaskManager.Ruled(_task, 1, PROOF, Ruling.Rejected, Fault.Nobody, 0, caseEnd, REPORT);
        _stand(Ruling.Rejected, 0, caseEnd);
        assertState(_task, TaskState.Ruled);
        Service memory s = services.service(_service);
        assertEq(s.taskId, 0);
        assertEq(s.bond, BOND - PENALTY);
        assertEq(s.rejected, 0);
        assertEq(s.failures, 0);
        Standing memory standing = tasks.standing(_task);
        assertEq(standing.penalty, PENALTY);
        assertEq(standing.until, caseEnd);
        assertEq(tasks.task(_task).proofHash, PROOF);
        assertAssigned(post(bob, REWARD), _service);
    }

    function test_aStandingRulingIsReplacedAndOnlyTheLastCounts() public {
        uint256 caseEnd = tasks.task(_task).caseEnd;
        Ruling[4] memory said = [Ruling.Rejected, Ruling.Accepted, Ruling.Void, Ruling.GivenUp];
        for (uint256 i = 0; i < 4; ++i) {
            _stand(said[i], said[i] == Ruling.Accepted ? PRICE : 0, caseEnd);
            assertEq(services.service(_service).bond, BOND - PENALTY, "set aside once");
        }
        uint256 before = coin.balanceOf(robot1);
        judgeAs(oracle, _task, Ruling.Accepted, 50 ether);
        assertEq(coin.balanceOf(robot1) - before, 50 ether);
        Service memory s = services.service(_service);
        assertEq(s.completed, 1);
        assertEq(s.rejected, 0);
        assertEq(s.bond, BOND);
    }

    function test_anybodyConcludesWheneverButNotBeforeItsTime() public {
        uint256 until = block.timestamp + 10 minutes;
        _stand(Ruling.Rejected, 0, until);
        vm.warp(until);
        vm.expectRevert(
            abi.encodeWithSelector(ITaskManager.RulingStands.selector, _task, until, block.timestamp)
        );
        vm.prank(stranger);
        tasks.conclude(_task);
        // A rejection that nobody closed before the deadline paid the forger once.
        vm.warp(block.timestamp + 400 days);
        vm.prank(stranger);
        tasks.conclude(_task);
        assertEq(services.service(_service).rejected, 1);
        assertEq(coin.balanceOf(robot1), 2000 ether - BOND);
    }

    function test_afterConcludeThereIsNoRuling() public {
        Finding memory f = finding(_task, Ruling.Rejected, 0);
        _stand(Ruling.Accepted, PRICE, block.timestamp + 10 minutes);
        vm.warp(block.timestamp + 11 minutes);
        tasks.conclude(_task);
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, _task, TaskState.Settled, TaskState.Submitted
            )
        );
        vm.prank(oracle);
        oracleJudge.rule(f, "");
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, _task, TaskState.Settled, TaskState.Ruled
            )
        );
        tasks.conclude(_task);
    }

    function test_theJudgeRulesPastTheDeadlineAndNotPastTheCase() public {
        Task memory a = tasks.task(_task);
        assertEq(a.caseEnd, a.deadline + AUDIT_WINDOW);
        vm.warp(a.caseEnd);
        uint256 snapshot = vm.snapshotState();
        judge(_task, true);
        assertState(_task, TaskState.Settled);
        vm.revertToState(snapshot);
        vm.warp(a.caseEnd + 1);
        vm.expectRevert(
            abi.encodeWithSelector(ITaskManager.CaseOver.selector, _task, a.caseEnd, block.timestamp)
        );
        this.judgeRejected();
    }

    function judgeRejected() external {
        judge(_task, false);
    }

    function test_onlyAVoidHasAFault() public {
        uint256 caseEnd = tasks.task(_task).caseEnd;
        Ruling[2] memory rulings = [Ruling.Rejected, Ruling.Void];
        for (uint256 i = 0; i < 2; ++i) {
            Fault said = i == 0 ? Fault.Nobody : Fault.Creator;
            vm.expectEmit();
            emit ITaskManager.Ruled(_task, 1, PROOF, rulings[i], said, 0, caseEnd, REPORT);
            vm.prank(address(oracleJudge));
            tasks.rule(_task, 1, PROOF, rulings[i], Fault.Creator, 0, uint40(caseEnd), REPORT);
        }
    }

    function test_silenceIsVoidUntilTheCaseEnds() public {
        Task memory a = tasks.task(_task);
        vm.warp(a.deadline);
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.DeadlineNotPassed.selector, _task, a.deadline, block.timestamp
            )
        );
        tasks.conclude(_task);
        vm.warp(a.deadline + 1);
        vm.expectEmit();
        emit ITaskManager.Ruled(_task, 1, PROOF, Ruling.Void, Fault.Oracle, 0, a.caseEnd, 0);
        vm.prank(stranger);
        tasks.conclude(_task);
        assertState(_task, TaskState.Ruled);
        vm.warp(a.caseEnd + 1);
        vm.prank(stranger);
        tasks.conclude(_task);
        assertState(_task, TaskState.Failed);
        assertEq(coin.balanceOf(alice), 2000 ether);
        _assertNoRecord();
    }

    function test_whoWasSilentMayStillRuleUntilTheCaseEnds() public {
        vm.warp(block.timestamp + WINDOW + 1);
        tasks.conclude(_task);
        judge(_task, true);
        assertEq(coin.balanceOf(robot1), 2000 ether - BOND + PRICE);
    }

    function test_silenceIsVoidAtOnceAfterTheCase() public {
        vm.warp(tasks.task(_task).caseEnd + 1);
        tasks.conclude(_task);
        assertState(_task, TaskState.Failed);
        assertEq(tasks.standing(_task).until, 0);
    }

    function test_aRulingStandsNoLongerThanItsCaseAndPaysWhatItMay() public {
        uint256 caseEnd = tasks.task(_task).caseEnd;
        uint256[2] memory untils = [block.timestamp, caseEnd + 1];
        for (uint256 i = 0; i < 2; ++i) {
            _expect(
                abi.encodeWithSelector(ITaskManager.InvalidUntil.selector, _task, untils[i], caseEnd),
                Ruling.Void,
                0,
                untils[i]
            );
        }
        Ruling[5] memory said =
            [Ruling.Accepted, Ruling.Accepted, Ruling.Rejected, Ruling.Impossible, Ruling.Void];
        uint256[5] memory amounts = [uint256(0), PRICE + 1, 1, 1, 1];
        for (uint256 i = 0; i < 5; ++i) {
            uint256 max = said[i] == Ruling.Accepted ? PRICE : 0;
            bytes memory wrong =
                abi.encodeWithSelector(ITaskManager.InvalidAmount.selector, _task, amounts[i], max);
            _expect(wrong, said[i], amounts[i], i % 2 == 0 ? caseEnd : 0);
        }
        _expect(abi.encodeWithSelector(ITaskManager.NoRuling.selector, _task), Ruling.None, 0, 0);
    }

    function test_onlyAVoidIsSomebodysFault() public {
        Finding memory f = finding(_task, Ruling.Rejected, 0);
        f.fault = Fault.Creator;
        vm.expectEmit(address(tasks));
        emit ITaskManager.Ruled(_task, 1, PROOF, Ruling.Rejected, Fault.Nobody, 0, 0, REPORT);
        vm.prank(oracle);
        oracleJudge.rule(f, "report");
        _again();
        f = finding(_task, Ruling.Void, 0);
        f.fault = Fault.Creator;
        vm.expectEmit(address(tasks));
        emit ITaskManager.Ruled(_task, f.attempt, PROOF, Ruling.Void, Fault.Creator, 0, 0, REPORT);
        vm.prank(oracle);
        oracleJudge.rule(f, "report");
    }

    function test_onlyTheTasksJudgeRules() public {
        address[5] memory others = [oracle, auditor, admin, robot1, address(auditorJudge)];
        for (uint256 i = 0; i < 5; ++i) {
            vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotJudge.selector, others[i], _number()));
            vm.prank(others[i]);
            tasks.rule(_task, 1, PROOF, Ruling.Accepted, Fault.Nobody, 1, 0, 0);
        }
    }

    // -- bonds ---------------------------------------------------------------------------------------------

    function test_whoseBondRunsShortHasNoTasksUntilACaseEnds() public {
        uint256 caseEnd = tasks.task(_task).caseEnd;
        TaskId[4] memory open;
        for (uint256 i = 0; i < 4; ++i) {
            open[i] = _task;
            _stand(Ruling.Void, 0, caseEnd);
            if (i == 3) break;
            _again();
            caseEnd = tasks.task(_task).caseEnd;
        }
        Service memory s = services.service(_service);
        assertEq(s.bond, 0);
        assertEq(uint8(s.state), uint8(ServiceState.Short));
        vm.expectRevert(abi.encodeWithSelector(IProviders.BondExhausted.selector, _service, 0, PENALTY));
        vm.prank(robot1);
        services.updateService(_service, PRICE, ServiceState.Active);
        TaskId waiting = post(alice, REWARD);
        assertState(waiting, TaskState.Open);
        judgeAs(oracle, open[0], Ruling.Void, 0);
        assertAssigned(waiting, _service);
    }

    /// @dev What is set aside may come back: until then a final rejection pauses the service, and suspends nothing.
    function test_aRejectionSuspendsNobodyWhosePenaltiesAreOnlySetAside() public {
        TaskId[4] memory open;
        for (uint256 i = 0; i < 4; ++i) {
            open[i] = _task;
            if (i == 3) break;
            _stand(Ruling.Void, 0, tasks.task(_task).caseEnd);
            _again();
        }
        judge(_task, false);
        assertEq(services.service(_service).bond, 0);
        assertEq(uint8(services.service(_service).state), uint8(ServiceState.Short));
        judgeAs(oracle, open[0], Ruling.Rejected, 0);
        assertEq(uint8(services.service(_service).state), uint8(ServiceState.Short), "two are open");
        judgeAs(oracle, open[1], Ruling.Rejected, 0);
        judgeAs(oracle, open[2], Ruling.Rejected, 0);
        assertEq(uint8(services.service(_service).state), uint8(ServiceState.Suspended), "nothing comes back");
    }

    function test_whatComesBackOfABondMakesARejectedServiceWorkAgain() public {
        setTerms(BOND, BOND, 0);
        ServiceId second = offer(robot1, 10 ether);
        TaskId taskId = post(bob, 10 ether);
        assertAssigned(taskId, second);
        submit(taskId);
        ruleUntil(oracleJudge, taskId, Ruling.Rejected, 0, tasks.task(taskId).caseEnd);
        assertEq(uint8(services.service(second).state), uint8(ServiceState.Short));
        judgeAs(oracle, taskId, Ruling.Void, 0);
        assertEq(services.service(second).bond, BOND);
        assertAssigned(post(bob, 10 ether), second);
    }

    /// @dev It waits under the number to which it has agreed, and not under that of the task whose case ended.
    function test_whatComesBackOfABondIsForTheKindAsTheServiceAgreedToIt() public {
        setTerms(BOND, BOND, 0);
        ServiceId second = offer(robot1, 10 ether);
        TaskId taskId = post(bob, 10 ether);
        submit(taskId);
        ruleUntil(oracleJudge, taskId, Ruling.Void, 0, tasks.task(taskId).caseEnd);
        post(bob, 10 ether);
        vm.startPrank(admin);
        organization.allowKind(CLEANING, roleJudge(ORACLE_ROLE, address(0)), RULES);
        vm.stopPrank();
        vm.prank(robot1);
        services.agree(second);
        TaskId under = post(bob, 10 ether);
        judgeAs(oracle, taskId, Ruling.Void, 0);
        assertAssigned(under, second);
    }

    function test_whoRetiresHasTheRestAtOnceAndThePenaltyWhenTheCaseEnds() public {
        _stand(Ruling.Void, 0, tasks.task(_task).caseEnd);
        uint256 before = coin.balanceOf(robot1);
        update(_service, PRICE, ServiceState.Retired);
        assertEq(coin.balanceOf(robot1) - before, BOND - PENALTY);
        judgeAs(oracle, _task, Ruling.Accepted, PRICE);
        assertEq(coin.balanceOf(robot1) - before, BOND + PRICE);
    }

    function test_whoRetiresLosesThePenaltyAllTheSame() public {
        _stand(Ruling.Void, 0, tasks.task(_task).caseEnd);
        update(_service, PRICE, ServiceState.Retired);
        uint256 before = coin.balanceOf(robot1);
        judgeAs(oracle, _task, Ruling.Rejected, 0);
        assertEq(coin.balanceOf(robot1), before);
        assertEq(tasks.held(), REWARD);
    }

    // -- passing on, and removal ---------------------------------------------------------------------------

    function test_whatTheOracleCannotDecideIsVoidUntilTheAuditorsDo() public {
        Task memory a = tasks.task(_task);
        vm.expectEmit();
        emit IJudge.PassedOn(_task, 1, address(auditorJudge));
        judgeAs(oracle, _task, Ruling.None, 0);
        Standing memory s = tasks.standing(_task);
        assertEq(uint8(s.ruling), uint8(Ruling.Void));
        assertEq(s.until, a.caseEnd);
        vm.warp(a.caseEnd);
        judgeAs(auditor, _task, Ruling.Accepted, 70 ether);
        assertEq(coin.balanceOf(robot1), 2000 ether - BOND + 70 ether);
    }

    function test_silentAuditorsPayNobody() public {
        judgeAs(oracle, _task, Ruling.None, 0);
        vm.warp(tasks.task(_task).caseEnd + 1);
        tasks.conclude(_task);
        assertEq(coin.balanceOf(alice), 2000 ether);
        assertEq(coin.balanceOf(robot1), 2000 ether - BOND);
        _assertNoRecord();
    }

    function test_whatARemovedJudgeSaidIsVoidAndTheAuditorsMayReplaceIt() public {
        _stand(Ruling.Accepted, PRICE, block.timestamp + 1 minutes);
        Task memory a = tasks.task(_task);
        _remove();
        vm.warp(block.timestamp + 2 minutes);
        vm.expectEmit();
        emit ITaskManager.Ruled(_task, 1, PROOF, Ruling.Void, Fault.Oracle, 0, a.caseEnd, 0);
        tasks.conclude(_task);
        assertState(_task, TaskState.Ruled);
        vm.expectRevert(
            abi.encodeWithSelector(ITaskManager.NotJudge.selector, address(oracleJudge), _number())
        );
        this.judgeRejected();
        vm.expectRevert(
            abi.encodeWithSelector(ITaskManager.RulingStands.selector, _task, a.caseEnd, block.timestamp)
        );
        tasks.conclude(_task);
        Finding memory f = finding(_task, Ruling.Accepted, 30 ether);
        vm.prank(auditor);
        auditorJudge.rule(f, "");
        assertEq(coin.balanceOf(robot1), 2000 ether - BOND + 30 ether);
    }

    function test_whatTheAuditorsSaidAfterARemovalStands() public {
        _stand(Ruling.Accepted, PRICE, block.timestamp + 1 minutes);
        _remove();
        Finding memory f = finding(_task, Ruling.Rejected, 0);
        vm.prank(address(auditorJudge));
        tasks.rule(
            _task, 1, PROOF, Ruling.Rejected, Fault.Nobody, 0, uint40(block.timestamp + 1 hours), f.reportHash
        );
        vm.warp(block.timestamp + 1 hours + 1);
        tasks.conclude(_task);
        assertEq(services.service(_service).rejected, 1);
    }

    function test_aRemovedJudgesRulingIsVoidAtOnceAfterTheCase() public {
        _stand(Ruling.Accepted, PRICE, block.timestamp + 1 minutes);
        _remove();
        vm.warp(tasks.task(_task).caseEnd + 1);
        tasks.conclude(_task);
        assertState(_task, TaskState.Failed);
        assertEq(coin.balanceOf(alice), 2000 ether);
    }

    function test_auditorsThatWereRemovedAsAJudgeRuleNoMore() public {
        vm.prank(admin);
        organization.setAuditors(oracleJudge);
        KindId number = _number();
        _remove();
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotJudge.selector, address(oracleJudge), number));
        this.judgeRejected();
    }

    function test_anOracleDecidesNothingAsAnAuditorThatItHasPassedOn() public {
        judgeAs(oracle, _task, Ruling.None, 0);
        bytes32 role = AUDITOR_ROLE;
        vm.prank(admin);
        organization.grantRole(role, oracle);
        Finding memory f = finding(_task, Ruling.Accepted, PRICE);
        vm.expectRevert(abi.encodeWithSelector(IJudge.JudgeIsAuditor.selector, _task, oracle));
        vm.prank(oracle);
        auditorJudge.ruleFor(oracleJudge, f, "");
        // What another oracle passes on it may decide.
        assertFalse(oracleJudge.hasPassedOn(_task, auditor));
        judgeAs(auditor, _task, Ruling.Accepted, PRICE);
        assertState(_task, TaskState.Settled);
    }

    /// @dev The oracle, an auditor meanwhile, wants to decide what it has passed on.
    function _passOnAndRemove() private returns (Finding memory f) {
        judgeAs(oracle, _task, Ruling.None, 0);
        bytes32 role = AUDITOR_ROLE;
        vm.prank(admin);
        organization.grantRole(role, oracle);
        f = finding(_task, Ruling.Accepted, PRICE);
        _remove();
    }

    function test_attack_whoPassedOnDecidesOnceItsJudgeWasRemoved() public {
        Finding memory f = _passOnAndRemove();
        vm.expectRevert(abi.encodeWithSelector(IJudge.PassedOnBefore.selector, _task, 1));
        vm.prank(oracle);
        auditorJudge.rule(f, "report");
        vm.prank(auditor);
        auditorJudge.rule(f, "report");
        assertState(_task, TaskState.Settled);
    }

    function test_attack_whoPassedOnGivesTheQuestionTooLittleGas() public {
        Finding memory f = _passOnAndRemove();
        for (uint256 gas = 100_000; gas <= 600_000; gas += 5000) {
            vm.prank(oracle);
            try auditorJudge.rule{gas: gas}(f, "report") {
                fail();
            } catch {}
        }
    }

    /// @dev It loops without end, or answers with what is no answer.
    function test_aRemovedJudgeHoldsUpNoAuditor() public {
        Finding memory f = _passOnAndRemove();
        bytes[2] memory codes = [bytes(hex"5b600056"), hex"600260005260206000f3"];
        for (uint256 i = 0; i < 2; ++i) {
            uint256 snapshot = vm.snapshotState();
            vm.etch(address(oracleJudge), codes[i]);
            vm.prank(auditor);
            auditorJudge.rule(f, "report");
            assertState(_task, TaskState.Settled);
            vm.revertToState(snapshot);
        }
        // Whoever gives it less than its gas is refused, because nobody knows what it would have answered.
        vm.etch(address(oracleJudge), codes[0]);
        uint256 refused = 0;
        for (uint256 gas = 100_000; gas <= 300_000; gas += 20_000) {
            vm.prank(auditor);
            try auditorJudge.rule{gas: gas}(f, "report") {
                break;
            } catch (bytes memory reason) {
                if (bytes4(reason) == IJudge.TooLittleGas.selector) ++refused;
            }
        }
        assertGt(refused, 0);
    }

    function test_onlyAGuardianOrTheAdministratorRemovesAJudge() public {
        KindId number = _number();
        vm.expectRevert();
        vm.prank(oracle);
        organization.removeJudge(number);
        vm.startPrank(admin);
        organization.grantRole(GUARDIAN_ROLE, bob);
        vm.stopPrank();
        vm.prank(bob);
        organization.removeJudge(number);
        assertTrue(tasks.isRemoved(number));
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotOrganization.selector, admin));
        vm.prank(admin);
        tasks.removeJudge(number);
    }

    function test_nobodyPostsWorkForAJudgeThatWasRemoved() public {
        KindId number = _number();
        _remove();
        vm.expectRevert(abi.encodeWithSelector(IOrganization.UnknownKind.selector, CLEANING));
        this.postForBob();
        vm.prank(admin);
        organization.allowKind(CLEANING, oracleJudge, RULES);
        assertTrue(organization.numberOf(CLEANING) != number);
        assertFalse(tasks.isRemoved(organization.numberOf(CLEANING)));
        this.postForBob();
    }

    function postForBob() external {
        post(bob, REWARD);
    }

    // -- another judge is another number -------------------------------------------------------------------

    function test_nobodysWorkComesUnderAJudgeThatItDidNotAgreeTo() public {
        TaskId waiting = post(bob, REWARD);
        RoleJudge another = roleJudge(ORACLE_ROLE, address(0));
        vm.prank(admin);
        organization.allowKind(CLEANING, another, RULES);
        assertEq(organization.numberOf(CLEANING), 3);
        judge(_task, true);
        assertAssigned(waiting, _service);
        TaskId newer = post(alice, REWARD);
        submit(waiting);
        judge(waiting, true);
        assertState(newer, TaskState.Open);
        uint96 bond = services.service(_service).bond;
        vm.prank(robot1);
        services.agree(_service);
        assertAssigned(newer, _service);
        assertEq(services.service(_service).bond, bond);
    }

    function test_newRulesKeepTheNumber() public {
        KindId number = _number();
        vm.prank(admin);
        organization.allowKind(CLEANING, oracleJudge, keccak256("next"));
        assertEq(organization.numberOf(CLEANING), KindId.unwrap(number));
    }

    function test_onlyTheProviderAgreesAndOnlyWhileIdle() public {
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.ServiceIsBusy.selector, _service, _task));
        vm.prank(robot1);
        services.agree(_service);
        vm.expectRevert(
            abi.encodeWithSelector(IServiceManager.NotProvider.selector, _service, stranger, robot1)
        );
        vm.prank(stranger);
        services.agree(_service);
    }

    function test_verdictAndAuditWindowTogetherFitIntoACase() public {
        Windows memory w = windows(SHORTEST, uint16(GRACE));
        w.auditWindow = 30 days;
        vm.prank(admin);
        organization.setWindows(CLEANING, w, 1 ether);
        TaskRequest memory wanted = request(REWARD);
        vm.expectRevert(
            abi.encodeWithSelector(
                IOrganization.InvalidVerdictWindow.selector, CLEANING, WINDOW, 15 minutes, 0
            )
        );
        vm.prank(alice);
        tasks.registerTask(wanted);
    }

    function _end(Ruling ruling, uint256 amount, bool standing)
        private
        returns (uint256 paid, uint256 refunded)
    {
        (uint256 ours, uint256 theirs) = (coin.balanceOf(robot1), coin.balanceOf(alice));
        if (standing) {
            _stand(ruling, amount, block.timestamp + 1 minutes);
            assertEq(coin.balanceOf(robot1), ours, "nothing is paid while a ruling stands");
            vm.warp(block.timestamp + 1 minutes + 1);
            vm.prank(stranger);
            tasks.conclude(_task);
        } else {
            judgeAs(oracle, _task, ruling, amount);
        }
        assertEq(tasks.standing(_task).until, 0);
        return (coin.balanceOf(robot1) - ours, coin.balanceOf(alice) - theirs);
    }

    /// @dev The next proof waits.
    function _again() private {
        if (state(_task) != TaskState.Assigned) _task = post(alice, REWARD);
        submit(_task);
    }

    function _stand(Ruling ruling, uint256 amount, uint256 until) private {
        ruleUntil(oracleJudge, _task, ruling, amount, until);
    }

    function _expect(bytes memory wrong, Ruling ruling, uint256 amount, uint256 until) private {
        vm.expectRevert(wrong);
        vm.prank(address(oracleJudge));
        tasks.rule(_task, 1, PROOF, ruling, Fault.Nobody, uint96(amount), uint40(until), REPORT);
    }

    function _remove() private {
        KindId number = _number();
        vm.prank(admin);
        organization.removeJudge(number);
    }

    function _number() private view returns (KindId) {
        return organization.numberOf(CLEANING);
    }

    function _assertNoRecord() private view {
        Service memory s = services.service(_service);
        assertEq(s.completed + s.rejected + s.expired + s.failures, 0);
        assertEq(s.bond, BOND);
        assertEq(s.reputation, 32);
    }
}
